//! Differences between documents, key by key.

use serde_json::Value;

/// Longest list whose entries are compared one by one.
const LONGEST_LIST: usize = 16;
/// Longest value that is shown as it is, in letters.
const LONGEST_VALUE: usize = 40;

/// A key at which documents differ, with the value in each.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Difference {
    /// Such as `fixture.yield_n`.
    pub(super) key: String,
    /// In the order of the documents; `None` where there is no such key.
    pub(super) values: Vec<Option<Value>>,
}

impl Difference {
    /// Returns the key and the values as texts.
    pub(super) fn cells(&self) -> Vec<String> {
        let shown = |value: &Option<Value>| value.as_ref().map_or("-".to_owned(), shown);
        std::iter::once(self.key.clone()).chain(self.values.iter().map(shown)).collect()
    }
}

/// Returns all keys at which the documents differ, sorted by name.
pub(super) fn differences(documents: &[Value]) -> Vec<Difference> {
    let mut found = Vec::new();
    visit(String::new(), &documents.iter().map(Some).collect::<Vec<_>>(), &mut found);
    found
}

fn visit(key: String, values: &[Option<&Value>], found: &mut Vec<Difference>) {
    if values.windows(2).all(|pair| pair[0] == pair[1]) {
        return;
    }
    let groups: Option<Vec<_>> = values.iter().map(|value| value.and_then(Value::as_object)).collect();
    if let Some(groups) = groups {
        let mut keys: Vec<&String> = groups.iter().flat_map(|group| group.keys()).collect();
        keys.sort_unstable();
        keys.dedup();
        for inner in keys {
            let path = if key.is_empty() { inner.clone() } else { format!("{key}.{inner}") };
            visit(path, &groups.iter().map(|group| group.get(inner)).collect::<Vec<_>>(), found);
        }
        return;
    }
    let lists: Option<Vec<_>> = values.iter().map(|value| value.and_then(Value::as_array)).collect();
    let is_short = |lists: &Vec<&Vec<Value>>| {
        lists.windows(2).all(|pair| pair[0].len() == pair[1].len()) && lists[0].len() <= LONGEST_LIST
    };
    if let Some(lists) = lists.filter(is_short) {
        for at in 0..lists[0].len() {
            visit(format!("{key}[{at}]"), &lists.iter().map(|list| list.get(at)).collect::<Vec<_>>(), found);
        }
        return;
    }
    found.push(Difference { key, values: values.iter().map(|value| value.cloned()).collect() });
}

fn shown(value: &Value) -> String {
    let text = match value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    match value {
        _ if text.chars().count() <= LONGEST_VALUE => text,
        Value::Array(items) if items.len() == 1 => "1 entry".to_owned(),
        Value::Array(items) => format!("{} entries", items.len()),
        Value::Object(_) => "a group".to_owned(),
        _ => text.chars().take(LONGEST_VALUE).chain(['\u{2026}']).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn keys_that_differ_are_named_with_what_each_document_has() {
        let one = json!({ "a": 1, "b": { "c": [1.0, 2.0], "d": null }, "e": "x", "long": vec![0; 20] });
        let other = json!({ "a": 1, "b": { "c": [1.0, 2.5], "d": { "f": 3 } }, "g": 7, "long": vec![1; 20] });
        let found = differences(&[one.clone(), other, one.clone()]);
        let keys: Vec<&str> = found.iter().map(|difference| difference.key.as_str()).collect();
        assert_eq!(keys, ["b.c[1]", "b.d", "e", "g", "long"]);
        assert_eq!(found[0].cells(), ["b.c[1]", "2.0", "2.5", "2.0"]);
        assert_eq!(found[1].cells(), ["b.d", "null", r#"{"f":3}"#, "null"]);
        assert_eq!(found[3].cells(), ["g", "-", "7", "-"]);
        assert_eq!(found[4].cells(), ["long", "20 entries", "20 entries", "20 entries"]);
        assert_eq!(differences(&[one.clone(), one]), []);
    }
}
