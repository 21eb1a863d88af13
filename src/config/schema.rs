//! The JSON Schema of all documents, and its information about keys.

use std::sync::LazyLock;

use schemars::{JsonSchema, SchemaGenerator};
use serde_json::{Map, Value, json};

use super::kind::Kind;
use super::kind::LIKE;
use super::outline::{Step, steps};
use super::suggest::nearest;
use super::tree::{Figure, ImpedanceDevice, Rig, Scene, Simulation};
use yieldwall_drives::codes::ErrorCodes;
use yieldwall_drives::profiles::DeviceProfile;

/// The JSON Schema of every kind of document, for editors. It is committed as `config/schema.json`.
pub fn schema() -> Value {
    let mut generator = SchemaGenerator::default();
    let mut kinds = vec![
        Value::from(Rig::json_schema(&mut generator)),
        ImpedanceDevice::json_schema(&mut generator).into(),
        Scene::json_schema(&mut generator).into(),
        Figure::json_schema(&mut generator).into(),
        DeviceProfile::json_schema(&mut generator).into(),
        Simulation::json_schema(&mut generator).into(),
        ErrorCodes::json_schema(&mut generator).into(),
    ];
    let mut definitions = generator.take_definitions(true);
    let variants: Vec<Value> = Kind::ALL
        .iter()
        .zip(&kinds)
        .filter(|(kind, _)| kind.has_variants())
        .map(|(kind, whole)| variant(*kind, whole, &mut definitions))
        .collect();
    // Variants of several kinds may have the same keys.
    kinds.push(json!({ "anyOf": variants }));
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "yieldwall configuration",
        "description": "A rig, an impedance device or a scene, whole or as a variant; or a figure, a device profile, a simulation or a table of error codes.",
        "oneOf": kinds,
        "$defs": definitions,
    })
}

/// Returns the schema of a variant: the keys of its kind, none of them required, and the base file.
fn variant(kind: Kind, whole: &Value, definitions: &mut Map<String, Value>) -> Value {
    let mut schema = loosen(whole, definitions);
    schema["description"] =
        format!("A variant of a {kind}: the keys that differ from those of the {kind} that it is like.").into();
    schema["required"] = json!([LIKE]);
    schema["properties"][LIKE] = json!({
        "description": format!("File of the {kind} that this one is a variant of, relative to this file; it may be a variant itself. \
            Groups are merged with those of that file key by key, drives by their names; anything else replaces what stands there."),
        "type": "string",
        "minLength": 1,
    });
    schema
}

/// Returns a schema without required keys, except the key of a choice and the name of an entry.
fn loosen(schema: &Value, definitions: &mut Map<String, Value>) -> Value {
    let mut loose = schema.clone();
    if let Some(name) = reference(schema) {
        let Some(whole) = definitions.get(name).cloned() else { return loose };
        let part = loosen(&whole, definitions);
        if part != whole {
            let name = format!("{name}Part");
            loose["$ref"] = format!("#/$defs/{name}").into();
            definitions.insert(name, part);
        }
        return loose;
    }
    let is_choice = has_one_key(schema);
    if let Some(Value::Object(keys)) = loose.get_mut("properties") {
        keys.values_mut().for_each(|key| *key = loosen(key, definitions));
    }
    if let Some(entries) = loose.get_mut("additionalProperties").filter(|entries| entries.is_object()) {
        *entries = loosen(entries, definitions);
    }
    for key in ["oneOf", "anyOf"] {
        if let Some(Value::Array(choices)) = loose.get_mut(key) {
            choices.iter_mut().for_each(|choice| *choice = loosen(choice, definitions));
        }
    }
    let entry =
        schema.get("items").map(|items| reference(items).and_then(|name| definitions.get(name)).unwrap_or(items));
    if entry.and_then(|entry| entry.get("properties")?.get("name")).is_some()
        && let (Some(entry), Some(list)) = (entry.cloned(), loose.as_object_mut())
    {
        let mut entry = loosen(&entry, definitions);
        entry["required"] = json!(["name"]);
        list.insert("items".to_owned(), entry);
        list.insert("minItems".to_owned(), json!(1));
    }
    if !is_choice && let Some(schema) = loose.as_object_mut() {
        schema.remove("required");
    }
    loose
}

/// The schema for questions about keys, made once: every file that is read asks, and making the schema takes longer than reading
/// a file.
static ASKED: LazyLock<Value> = LazyLock::new(schema);

/// Returns the description of a key, such as `fixture.yield_n`: of a rig, else of another kind of file that has it. `None` if none has.
///
/// As in `--set`, an entry of a list goes by its name (`drives.left.direction`), and the keys of a scene may begin with `scene.`.
pub fn key_description(path: &str) -> Option<String> {
    let of_any = |path: &str| Kind::ALL.into_iter().find_map(|kind| Guide::new(kind).named(path));
    of_any(path).or_else(|| path.strip_prefix("scene.").and_then(of_any))
}

/// Returns the key most similar to this one: of a rig, else of another kind of file that has it. A word without a dot may be the last
/// part of a key in a group of the rig.
pub fn nearest_key(path: &str) -> Option<String> {
    match path.contains('.') {
        true => Kind::ALL.into_iter().find_map(|kind| Guide::new(kind).nearest(path)),
        false => Guide::new(Kind::Rig).nearest_in_groups(path),
    }
}

/// The schema of one kind of document, for questions about its keys.
pub(super) struct Guide {
    root: &'static Value,
    kind: Kind,
}

impl Guide {
    pub(super) fn new(kind: Kind) -> Self {
        Self { root: &ASKED, kind }
    }

    /// Returns the text of a key's doc comment.
    pub(super) fn description(&self, path: &str) -> Option<String> {
        let text = self.find(path)?.get("description")?.as_str()?;
        Some(text.replace('\n', " "))
    }

    /// Returns the text of a key in whose path an entry of a list has its name in place of its number.
    fn named(&self, path: &str) -> Option<String> {
        let mut numbered = String::new();
        for part in path.split('.') {
            let is_list = self.find(&numbered).is_some_and(|above| self.resolve(above).get("items").is_some());
            match (is_list, numbered.is_empty()) {
                (true, _) => numbered.push_str("[0]"),
                (false, true) => numbered.push_str(part),
                (false, false) => numbered.extend([".", part]),
            }
        }
        self.description(&numbered)
    }

    /// Returns the key most similar to this one, part by part.
    fn nearest(&self, path: &str) -> Option<String> {
        let mut found = String::new();
        for part in path.split('.') {
            let keys = self.keys(&found);
            let meant = if keys.contains(&part) { part } else { nearest(part, keys)? };
            found = if found.is_empty() { meant.to_owned() } else { format!("{found}.{meant}") };
        }
        self.description(&found).map(|_| found)
    }

    /// Returns the key in a group of the file whose last part is most similar to this word.
    fn nearest_in_groups(&self, word: &str) -> Option<String> {
        self.keys("").into_iter().find_map(|group| {
            let meant = format!("{group}.{}", nearest(word, self.keys(group))?);
            self.description(&meant).map(|_| meant)
        })
    }

    /// Returns the keys of the group at a path.
    fn keys(&self, path: &str) -> Vec<&str> {
        let Some(schema) = self.find(path).map(|schema| self.resolve(schema)) else { return Vec::new() };
        let groups = std::iter::once(schema).chain(alternatives(schema).map(|choice| self.resolve(choice)));
        let keys = groups.filter_map(|group| group.get("properties")?.as_object());
        keys.flat_map(|keys| keys.keys().map(String::as_str)).collect()
    }

    /// Describes in words the values allowed at a path.
    pub(super) fn expectation(&self, path: &str) -> Option<String> {
        self.expect(self.find(path)?)
    }

    /// Whether the tree has a key there.
    pub(super) fn has(&self, path: &str) -> bool {
        self.find(path).is_some()
    }

    /// Whether the value at a path is a choice: a group with one of several keys.
    pub(super) fn is_choice(&self, path: &str) -> bool {
        self.find(path).is_some_and(|schema| self.chooses(schema))
    }

    fn chooses(&self, schema: &Value) -> bool {
        let schema = self.resolve(schema);
        let choices: Vec<&Value> = alternatives(schema).filter(|choice| !is_null(choice)).collect();
        match choices.as_slice() {
            [] => false,
            [only] => self.chooses(only),
            several => several.iter().all(|choice| has_one_key(choice)),
        }
    }

    fn find(&self, path: &str) -> Option<&Value> {
        let place = Kind::ALL.iter().position(|kind| *kind == self.kind)?;
        steps(path).try_fold(self.root.get("oneOf")?.get(place)?, |schema, step| self.step(schema, step))
    }

    fn resolve<'a>(&'a self, schema: &'a Value) -> &'a Value {
        reference(schema).and_then(|name| self.root.get("$defs")?.get(name)).unwrap_or(schema)
    }

    fn step<'a>(&'a self, schema: &'a Value, step: Step<'_>) -> Option<&'a Value> {
        let schema = self.resolve(schema);
        let direct = match step {
            Step::Key(key) => {
                schema.get("properties").and_then(|keys| keys.get(key)).or_else(|| schema.get("additionalProperties"))
            }
            Step::Index(_) => schema.get("items"),
        };
        // `additionalProperties: false` says that there is no such key.
        direct.filter(|found| found.is_object()).or_else(|| {
            alternatives(schema).find_map(|choice| {
                self.step(choice, step).or_else(|| {
                    // The key of a choice is not part of a path in the checked tree.
                    let only = choice.get("properties")?.as_object()?.values().next()?;
                    choice.get("required")?.as_array().filter(|keys| keys.len() == 1)?;
                    only.get("properties")?.get(step.key()?)
                })
            })
        })
    }

    fn expect(&self, schema: &Value) -> Option<String> {
        let schema = self.resolve(schema);
        let or_null = |text: String| if allows_null(schema) { format!("{text} or null") } else { text };
        let number = |key: &str| schema.get(key).and_then(Value::as_f64);
        let is = |name: &str| match schema.get("type") {
            Some(Value::String(single)) => single == name,
            Some(Value::Array(several)) => several.iter().any(|one| one == name),
            _ => false,
        };
        if alternatives(schema).next().is_some() {
            return self.expect_one_of(schema).map(or_null);
        }
        let text = if let Some(Value::Array(words)) = schema.get("enum") {
            format!("one of {}", words.iter().filter_map(Value::as_str).collect::<Vec<_>>().join(", "))
        } else if is("integer") {
            match (number("minimum"), number("maximum")) {
                (Some(low), Some(high)) => format!("a whole number from {low} to {high}"),
                (Some(low), None) => format!("a whole number, at least {low}"),
                _ => "a whole number".to_owned(),
            }
        } else if is("number") {
            match (number("exclusiveMinimum"), number("minimum")) {
                (Some(low), _) => format!("a number above {low}"),
                (_, Some(low)) => format!("a number, {low} or above"),
                _ => "a number".to_owned(),
            }
        } else if is("string") {
            if number("minLength").is_some() { "a text that is not empty".to_owned() } else { "a text".to_owned() }
        } else if is("array") {
            let item = schema.get("items").and_then(|items| self.expect(items)).unwrap_or_default();
            match (number("minItems"), number("maxItems")) {
                (Some(low), Some(high)) if low == high => format!("a list of {low} entries, each {item}"),
                (Some(low), Some(high)) => format!("a list of {low} to {high} entries, each {item}"),
                (Some(_), None) => format!("a list that is not empty, each entry {item}"),
                _ => format!("a list, each entry {item}"),
            }
        } else if is("object") {
            match schema.get("properties").and_then(Value::as_object) {
                Some(keys) => {
                    format!("a group with the keys {}", keys.keys().map(String::as_str).collect::<Vec<_>>().join(", "))
                }
                None => "a group of keys".to_owned(),
            }
        } else {
            return None;
        };
        Some(or_null(text))
    }

    fn expect_one_of(&self, schema: &Value) -> Option<String> {
        let choices: Vec<&Value> = alternatives(schema).filter(|choice| !is_null(choice)).collect();
        if let [only] = choices.as_slice() {
            return self.expect(only);
        }
        let words: Option<Vec<&str>> = choices.iter().map(|choice| choice.get("const")?.as_str()).collect();
        if let Some(words) = words {
            return Some(format!("one of {}", words.join(", ")));
        }
        if !choices.iter().all(|choice| has_one_key(choice)) {
            let each: Vec<String> = choices.iter().filter_map(|choice| self.expect(choice)).collect();
            return Some(each.join(" or "));
        }
        let keys: Vec<&str> = choices
            .iter()
            .filter_map(|choice| choice.get("properties")?.as_object()?.keys().next())
            .map(String::as_str)
            .collect();
        Some(format!("a group with one of the keys {}", keys.join(", ")))
    }
}

impl<'a> Step<'a> {
    fn key(self) -> Option<&'a str> {
        match self {
            Self::Key(key) => Some(key),
            Self::Index(_) => None,
        }
    }
}

fn alternatives(schema: &Value) -> impl Iterator<Item = &Value> {
    ["oneOf", "anyOf"].into_iter().filter_map(|key| schema.get(key)?.as_array()).flatten()
}

/// Returns the name of the definition that a schema refers to.
fn reference(schema: &Value) -> Option<&str> {
    schema.get("$ref")?.as_str()?.strip_prefix("#/$defs/")
}

/// Whether a schema is the schema of a group with one required key.
fn has_one_key(schema: &Value) -> bool {
    let count = |key: &str| match schema.get(key) {
        Some(Value::Object(keys)) => keys.len(),
        Some(Value::Array(keys)) => keys.len(),
        _ => 0,
    };
    count("properties") == 1 && count("required") == 1
}

fn is_null(schema: &Value) -> bool {
    schema.get("type").is_some_and(|kind| kind == "null")
}

fn allows_null(schema: &Value) -> bool {
    alternatives(schema).any(is_null)
        || schema.get("type").and_then(Value::as_array).is_some_and(|kinds| kinds.iter().any(|kind| kind == "null"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Prints the schema; the message of the test below says how it is refreshed.
    #[test]
    fn a_key_with_a_slip_is_known() {
        for (slip, meant) in [
            ("fixture.yeild_n", Some("fixture.yield_n")),
            ("fixtrue.yield", Some("fixture.yield_n")),
            ("fixture.coupling.admittance.mass", Some("fixture.coupling.admittance.mass_kg")),
            ("yield", Some("fixture.yield_n")),
            ("fixture.xyzzy", None),
            ("xyzzy", None),
        ] {
            assert_eq!(nearest_key(slip).as_deref(), meant, "{slip}");
        }
    }

    #[test]
    fn committed_schema_is_current() {
        let committed: Value = serde_json::from_str(include_str!("../../config/schema.json")).unwrap();
        assert!(
            committed == schema(),
            "config/schema.json is stale; refresh it with\n  cargo run -- config schema > config/schema.json.new && mv \
             config/schema.json.new config/schema.json"
        );
    }

    #[test]
    fn keys_are_described_through_references_choices_and_lists() {
        let guide = Guide::new(Kind::Rig);
        assert!(guide.description("fixture.yield_n").unwrap().starts_with("R in N"));
        assert!(guide.description("fixture.coupling.admittance.mass_kg").unwrap().starts_with("M in kg"));
        assert!(guide.description("fixture.coupling.mass_kg").unwrap().starts_with("M in kg"));
        assert!(guide.description("drives[1].address.canopen.node_id").unwrap().starts_with("CANopen node-ID"));
        assert!(guide.description("simulation.arm.tool_kg").is_some());
        assert!(!guide.has("fixture.mass_kg") && !guide.has("nothing"));
    }

    #[test]
    fn choices_are_groups_with_one_of_several_keys() {
        let guide = Guide::new(Kind::Rig);
        for path in ["sensor.protocol", "control.gains", "fixture.coupling", "fixture.law", "fixture.surface"] {
            assert!(guide.is_choice(path), "{path}");
        }
        for path in
            ["sensor", "control.law", "control.feed_forward.inertia", "drives", "buses", "fixture.passivity", "x"]
        {
            assert!(!guide.is_choice(path), "{path}");
        }
    }

    #[test]
    fn a_variant_has_to_say_what_it_is_like_and_nothing_else() {
        let schema = schema();
        let variant = &schema["oneOf"].as_array().unwrap().last().unwrap()["anyOf"][0];
        assert_eq!(variant["required"], json!([LIKE]));
        let part = |name: &str| &schema["$defs"][name];
        assert_eq!(variant["properties"]["cycle"]["$ref"], "#/$defs/CyclePart");
        assert!(part("CyclePart").get("required").is_none() && part("Cycle").get("required").is_some());
        assert_eq!(variant["properties"]["drives"]["items"]["required"], json!(["name"]));
        assert_eq!(part("SensorProtocolPart")["oneOf"][0]["required"], json!(["canopen"]));
        assert!(part("SensorProtocolPart")["oneOf"][0]["properties"]["canopen"].get("required").is_none());
    }

    #[test]
    fn expectations_are_words() {
        let guide = Guide::new(Kind::Rig);
        let expect = |path| guide.expectation(path).unwrap();
        assert_eq!(expect("buses.main.canopen.node_id"), "a whole number from 1 to 127");
        assert_eq!(expect("rig.command_mode"), "one of torque, velocity, position");
        assert_eq!(expect("sensor.low_pass_hz"), "a number above 0 or null");
        assert_eq!(expect("linkage.proximal_m"), "a list of 2 entries, each a number above 0");
        assert_eq!(expect("fixture.coupling"), "a group with one of the keys admittance, impedance");
        assert_eq!(expect("cycle"), "a group with the keys compute_at_us, period_us");
    }
}
