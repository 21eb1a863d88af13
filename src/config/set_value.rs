//! Values that override values of a file: a variant without a file of its own.

use std::str::FromStr;

use thiserror::Error;

use super::source::{Source, Values, like};

/// The key of a list whose entries have names.
const DRIVES: &str = "drives";
/// Prefix of the keys of the scene.
const SCENE: &str = "scene";

/// A value and its key, as `fixture.yield_n=25`. Drives go by their names: `drives.left.direction=-1`. Keys of the scene begin with `scene.`:
/// `scene.hand.mass_kg=1.0`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SetValue {
    keys: Vec<String>,
    value: String,
}

/// Reason why a text sets no value, or why values contradict each other.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SetValueError {
    /// There is no `=`.
    #[error("{0} is not KEY=VALUE, such as fixture.yield_n=25")]
    NoValue(String),
    /// A key is empty, has a character other than letters, digits, `_` and `-`, or names a whole drive.
    #[error(
        "{0} is not a key: write the whole path, outermost key first, such as fixture.yield_n or drives.left.direction"
    )]
    NoKey(String),
    /// The value is longer than one line.
    #[error("the value of {0} has more than one line: write it on one, such as [1.0, 0.0]")]
    Lines(String),
    /// A value among several is missing.
    #[error("{0} has an empty value: write each one, such as {0}=1,2,3")]
    Empty(String),
    /// Two values set the same key, or one sets a group and the other a part of that group.
    #[error("{0} is set twice")]
    Twice(String),
}

impl SetValue {
    /// Reads `KEY=a,b,c`: one result for each of the values. Commas within brackets, braces and quotes are parts of a value.
    ///
    /// # Errors
    /// As its [`FromStr`]; or a value is empty.
    pub fn each(text: &str) -> Result<Vec<Self>, SetValueError> {
        let (key, values) = text.split_once('=').ok_or_else(|| SetValueError::NoValue(text.to_owned()))?;
        let (mut depth, mut quote, mut from) = (0_usize, None, 0);
        let mut parts = Vec::new();
        for (place, one) in values.char_indices() {
            match (one, quote) {
                (_, Some(open)) if one == open => quote = None,
                (_, Some(_)) => {}
                ('"' | '\'', None) => quote = Some(one),
                ('[' | '{', None) => depth += 1,
                (']' | '}', None) => depth = depth.saturating_sub(1),
                (',', None) if depth == 0 => {
                    parts.push(&values[from..place]);
                    from = place + 1;
                }
                _ => {}
            }
        }
        parts.push(&values[from..]);
        if parts.iter().any(|part| part.trim().is_empty()) {
            return Err(SetValueError::Empty(key.to_owned()));
        }
        parts.iter().map(|part| format!("{key}={}", part.trim()).parse()).collect()
    }

    /// The key, with the keys above it, as it was written.
    pub fn key(&self) -> String {
        self.keys.join(".")
    }

    /// Whether the value is one of the scene.
    pub fn is_of_scene(&self) -> bool {
        self.keys.len() > 1 && self.keys.first().is_some_and(|key| key == SCENE)
    }

    /// The value in YAML.
    pub fn value(&self) -> &str {
        &self.value
    }
}

impl FromStr for SetValue {
    type Err = SetValueError;

    fn from_str(text: &str) -> Result<Self, SetValueError> {
        let (path, value) = text.split_once('=').ok_or_else(|| SetValueError::NoValue(text.to_owned()))?;
        let keys: Vec<String> = path.split('.').map(str::to_owned).collect();
        let is_key = |key: &String| {
            !key.is_empty() && key.chars().all(|one| one.is_ascii_alphanumeric() || matches!(one, '_' | '-'))
        };
        let is_part_of_drive = |keys: &[String]| keys.first().is_none_or(|key| key != DRIVES) || keys.len() > 2;
        if !keys.iter().all(is_key) || !is_part_of_drive(&keys) {
            return Err(SetValueError::NoKey(path.to_owned()));
        }
        if value.contains(['\n', '\r']) {
            return Err(SetValueError::Lines(path.to_owned()));
        }
        Ok(Self { keys, value: value.to_owned() })
    }
}

/// A group of the text that is written: each key with its value or its group.
#[derive(Default)]
struct Group(Vec<(String, Entry)>);

enum Entry {
    Value(String),
    Group(Group),
}

impl Group {
    /// Puts a value at its place, and returns whether the place was free.
    fn put(&mut self, keys: &[String], value: &str) -> bool {
        let [key, rest @ ..] = keys else { return false };
        let place = self.0.iter_mut().find(|(known, _)| known == key).map(|(_, entry)| entry);
        match (place, rest) {
            (None, []) => self.0.push((key.clone(), Entry::Value(value.to_owned()))),
            (None, _) => {
                let mut group = Group::default();
                group.put(rest, value);
                self.0.push((key.clone(), Entry::Group(group)));
            }
            (Some(Entry::Group(group)), [_, ..]) => return group.put(rest, value),
            (Some(_), _) => return false,
        }
        true
    }

    fn text(&self) -> String {
        let mut text = String::new();
        self.write(0, &mut text);
        text
    }

    /// Writes it in YAML, `indent` blanks from the left.
    fn write(&self, indent: usize, text: &mut String) {
        let blanks = " ".repeat(indent);
        for (key, entry) in &self.0 {
            match entry {
                Entry::Value(value) => text.push_str(&format!("{blanks}{key}: {value}\n")),
                Entry::Group(group) if indent == 0 && key == DRIVES => group.write_drives(text),
                Entry::Group(group) => {
                    text.push_str(&format!("{blanks}{key}:\n"));
                    group.write(indent + 2, text);
                }
            }
        }
    }

    /// Writes the drives, a list whose entries have names.
    fn write_drives(&self, text: &mut String) {
        text.push_str(&format!("{DRIVES}:\n"));
        for (name, entry) in &self.0 {
            text.push_str(&format!("  - name: {name}\n"));
            if let Entry::Group(group) = entry {
                group.write(4, text);
            }
        }
    }
}

impl Source {
    /// Returns a variant of this rig or impedance device in which `values` override its own and those of its scene; without any,
    /// the document itself.
    ///
    /// # Errors
    /// If a key is set twice.
    pub fn with_values(self, values: &[SetValue]) -> Result<Self, SetValueError> {
        let Some(name) = self.file_name().filter(|_| !values.is_empty()) else { return Ok(self) };
        let [mut machine, mut scene] = [Group::default(), Group::default()];
        for SetValue { keys, value } in values {
            let is_put = match keys.as_slice() {
                [first, of_scene @ ..] if first == SCENE && !of_scene.is_empty() => scene.put(of_scene, value),
                keys => machine.put(keys, value),
            };
            if !is_put {
                return Err(SetValueError::Twice(keys.join(".")));
            }
        }
        let [of_machine, of_scene] = [machine, scene].map(|group| group.text());
        let values = Values { file: self.path(), machine: like(name, &of_machine), scene: of_scene };
        Ok(self.beneath(values))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{builtin, load_rig};

    fn set(values: &[&str]) -> Result<Source, SetValueError> {
        let values = values.iter().map(|text| text.parse()).collect::<Result<Vec<_>, _>>()?;
        builtin("play.yaml").with_values(&values)
    }

    #[test]
    fn values_stand_over_those_of_the_file_and_of_its_simulation() {
        let values = [
            "fixture.yield_n=25",
            "fixture.law.ellipse={}",
            "drives.left.direction=-1",
            "drives.left.zero_offset_rad=0.1",
            "simulation.arm.coulomb_n_m=[0.0, 0.0]",
        ];
        let rig = load_rig(set(&values).unwrap()).unwrap().value;
        assert_eq!((*rig.fixture.yield_n, *rig.fixture.friction_n), (25.0, 3.0));
        assert_eq!(rig.fixture.law.map(|law| law.name()), Some("ellipse"));
        assert_eq!((rig.drives[0].direction, *rig.drives[0].zero_offset_rad), (-1, 0.1));
        assert_eq!(rig.drives[1].direction, 1);
        let simulation = serde_json::to_value(rig.simulation.unwrap()).unwrap();
        assert_eq!(simulation["arm"]["coulomb_n_m"], serde_json::json!([0.0, 0.0]));
        assert_eq!(simulation["arm"]["tool_kg"], 1.0);
        assert_eq!(set(&[]).unwrap(), builtin("play.yaml"));
    }

    #[test]
    fn a_bad_value_is_found_where_it_was_set() {
        let report = load_rig(set(&["fixture.yield_n=-1"]).unwrap()).unwrap_err();
        let finding = &report.diagnostics[0];
        assert_eq!(finding.file, "--set");
        assert!(finding.message.contains("fixture.yield_n"), "{}", finding.message);
        let report = load_rig(set(&["fixture.yeild_n=25"]).unwrap()).unwrap_err();
        assert!(report.diagnostics[0].help.as_ref().is_some_and(|help| help.contains("yield_n")), "{report:?}");
        // A value that is no YAML is an error of this text.
        assert_eq!(load_rig(set(&["fixture.yield_n=[1"]).unwrap()).unwrap_err().diagnostics[0].file, "--set");
    }

    #[test]
    fn a_file_that_cannot_be_read_is_refused_as_without_values() {
        let value: SetValue = "fixture.yield_n=25".parse().unwrap();
        for source in [Source::disk("no-such-file.yaml"), Source::memory("empty.yaml", "")] {
            let with_value = source.clone().with_values(std::slice::from_ref(&value)).unwrap();
            assert_eq!(load_rig(with_value).unwrap_err(), load_rig(source).unwrap_err());
        }
        let figure = load_rig(builtin("figures/fig9.yaml").with_values(&[value]).unwrap()).unwrap_err();
        assert!(figure.to_string().contains("--set needs a rig"), "{figure}");
        assert_eq!(figure.diagnostics[0].place, None);
    }

    #[test]
    fn what_sets_nothing_is_refused() {
        for (values, error) in [
            (&["fixture.yield_n"][..], SetValueError::NoValue("fixture.yield_n".into())),
            (&["=1"], SetValueError::NoKey(String::new())),
            (&["fixture..yield_n=1"], SetValueError::NoKey("fixture..yield_n".into())),
            (&["fixture.yield n=1"], SetValueError::NoKey("fixture.yield n".into())),
            (&["drives.left=1"], SetValueError::NoKey("drives.left".into())),
            (&["rig.name=a\nb: c"], SetValueError::Lines("rig.name".into())),
            (&["fixture.yield_n=1", "fixture.yield_n=2"], SetValueError::Twice("fixture.yield_n".into())),
            (&["fixture.law=null", "fixture.law.ellipse={}"], SetValueError::Twice("fixture.law.ellipse".into())),
        ] {
            assert_eq!(set(values).unwrap_err(), error, "{values:?}");
        }
    }

    #[test]
    fn a_rig_without_simulation_is_named_by_its_file() {
        let text = "like: builtin:play.yaml\nsimulation: null\n";
        let values = ["scene.duration_s=2.0".parse().unwrap()];
        let rig = load_rig(Source::memory("real.yaml", text).with_values(&values).unwrap()).unwrap();
        let report = rig.scene().unwrap_err();
        assert!(report.diagnostics[0].message.starts_with("real.yaml: "), "{report}");
    }

    #[test]
    fn values_of_the_scene_stand_over_those_of_its_file() {
        let values = ["scene.hand.mass_kg=1.5", "scene.duration_s=2.0", "fixture.yield_n=25"];
        let rig = load_rig(set(&values).unwrap()).unwrap();
        let (scene, file) = (rig.scene().unwrap(), crate::load_scene(builtin("scenes/push-and-let-go.yaml")).unwrap());
        assert_eq!((*scene.value.hand.mass_kg, *scene.value.duration_s), (1.5, 2.0));
        assert_eq!(scene.value.hand.path, file.value.hand.path);
        assert_eq!(*rig.value.fixture.yield_n, 25.0);
        let report = load_rig(set(&["scene.hand.mass_kg=-1"]).unwrap()).unwrap_err();
        assert_eq!(report.diagnostics[0].file, "--set");
        let report = load_rig(set(&["scene.hand.mas_kg=1"]).unwrap()).unwrap_err();
        assert!(report.diagnostics[0].help.as_ref().is_some_and(|help| help.contains("mass_kg")), "{report:?}");
        // An impedance device names its scene at the top.
        let values: Vec<SetValue> =
            ["scene.hand.mass_kg=1.5", "fixture.friction_n=1.0"].iter().map(|text| text.parse().unwrap()).collect();
        let device = crate::load_device(builtin("sphere.yaml").with_values(&values).unwrap()).unwrap();
        assert_eq!((*device.scene().unwrap().value.hand.mass_kg, *device.value.fixture.friction_n), (1.5, 1.0));
    }

    #[test]
    fn several_values_of_a_key_are_told_apart_by_commas_outside_of_brackets() {
        let values =
            |text: &str| SetValue::each(text).map(|all| all.iter().map(|one| one.value().to_owned()).collect());
        assert_eq!(values("a.b=1, 2,3"), Ok(vec!["1".to_owned(), "2".into(), "3".into()]));
        assert_eq!(values("a=[1, 2],[3, 4]"), Ok(vec!["[1, 2]".to_owned(), "[3, 4]".into()]));
        assert_eq!(values("a={b: {c: 1, d: 2}},null"), Ok(vec!["{b: {c: 1, d: 2}}".to_owned(), "null".into()]));
        assert_eq!(values("a='x, y',\"z, 1\""), Ok(vec!["'x, y'".to_owned(), "\"z, 1\"".into()]));
        assert_eq!(values("a=1,,2"), Err(SetValueError::Empty("a".into())));
        assert_eq!(values("a="), Err(SetValueError::Empty("a".into())));
        assert_eq!(SetValue::each("a.b=1").unwrap()[0].key(), "a.b");
    }
}
