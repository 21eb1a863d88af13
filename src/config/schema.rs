//! The JSON Schema of all documents, and what it says about a key.

use schemars::{JsonSchema, SchemaGenerator};
use serde_json::{Value, json};

use super::kind::Kind;
use super::outline::{Step, steps};
use super::tree::{Figure, ImpedanceDevice, Rig, Scene};
use yieldwall_drives::profiles::DeviceProfile;

/// The JSON Schema of every kind of document, for editors. It is committed as `config/schema.json`.
pub fn schema() -> Value {
    let mut generator = SchemaGenerator::default();
    let kinds = [
        Rig::json_schema(&mut generator),
        ImpedanceDevice::json_schema(&mut generator),
        Scene::json_schema(&mut generator),
        Figure::json_schema(&mut generator),
        DeviceProfile::json_schema(&mut generator),
    ];
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "yieldwall configuration",
        "description": "A rig, an impedance device, a scene, a figure or a device profile.",
        "oneOf": kinds,
        "$defs": generator.take_definitions(true),
    })
}

/// The schema of one kind of document, for questions about its keys.
pub(super) struct Guide {
    root: Value,
    kind: Kind,
}

impl Guide {
    pub(super) fn new(kind: Kind) -> Self {
        Self { root: schema(), kind }
    }

    /// What the doc comment of a key says.
    pub(super) fn description(&self, path: &str) -> Option<String> {
        let text = self.find(path)?.get("description")?.as_str()?;
        Some(text.replace('\n', " "))
    }

    /// What may stand at a path, in words.
    pub(super) fn expectation(&self, path: &str) -> Option<String> {
        self.expect(self.find(path)?)
    }

    /// Whether the tree has a key there.
    pub(super) fn has(&self, path: &str) -> bool {
        self.find(path).is_some()
    }

    fn find(&self, path: &str) -> Option<&Value> {
        let place = Kind::ALL.iter().position(|kind| *kind == self.kind)?;
        steps(path).try_fold(self.root.get("oneOf")?.get(place)?, |schema, step| self.step(schema, step))
    }

    fn resolve<'a>(&'a self, schema: &'a Value) -> &'a Value {
        let name = schema.get("$ref").and_then(Value::as_str).and_then(|name| name.strip_prefix("#/$defs/"));
        name.and_then(|name| self.root.get("$defs")?.get(name)).unwrap_or(schema)
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
        assert!(guide.description("drives[1].node_id").unwrap().starts_with("CANopen node-ID"));
        assert!(guide.description("buses.main.timing").is_some());
        assert!(!guide.has("fixture.mass_kg") && !guide.has("nothing"));
    }

    #[test]
    fn expectations_are_words() {
        let guide = Guide::new(Kind::Rig);
        let expect = |path| guide.expectation(path).unwrap();
        assert_eq!(expect("master.node_id"), "a whole number from 1 to 127");
        assert_eq!(expect("rig.command_mode"), "one of torque, velocity, position");
        assert_eq!(expect("sensor.low_pass_hz"), "a number above 0 or null");
        assert_eq!(expect("linkage.proximal_m"), "a list of 2 entries, each a number above 0");
        assert_eq!(expect("fixture.coupling"), "a group with one of the keys admittance, impedance");
        assert_eq!(expect("cycle"), "a group with the keys compute_at_us, period_us");
    }
}
