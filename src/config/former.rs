//! Keys of earlier versions: what stands in their place now, written out.

use super::compose::in_block_style;
use super::diagnostic::{Diagnostic, Severity};
use super::kind::Kind;
use super::locator::Locator;
use super::outline::{Content, Node};

/// The finding for a document in the form of an earlier version, each key at its place.
pub(super) fn former(locator: &Locator, kind: Kind) -> Vec<Diagnostic> {
    if kind != Kind::Rig {
        return Vec::new();
    }
    let mut found: Vec<Diagnostic> =
        buses(locator).into_iter().chain(drives(locator)).chain(simulation(locator)).collect();
    found.sort_by_key(|finding| finding.place.map(|place| place.offset));
    found
}

/// A bus did not say its kind, and this program as a node stood beside the buses.
fn buses(locator: &Locator) -> Option<Diagnostic> {
    let top = || entries(locator.outline.root.as_ref());
    let master = top().find(|(key, _)| *key == "master").map(|(_, node)| node);
    let buses = || entries(top().find(|(key, _)| *key == "buses").map(|(_, node)| node));
    let rate = |bus: &'_ Node| scalar(Some(bus), "bit_rate_bit_per_s");
    let former: Vec<String> = buses()
        .filter(|(_, bus)| rate(bus).is_some())
        .map(|(name, _)| format!("buses.{name}.bit_rate_bit_per_s"))
        .chain(master.map(|_| "master".to_owned()))
        .collect();
    let first = former.first()?;
    let lines: Vec<String> = buses()
        .map(|(name, bus)| {
            let keys = [
                ("bit_rate_bit_per_s", rate(bus)),
                ("node_id", scalar(master, "node_id")),
                ("heartbeat_ms", scalar(master, "heartbeat_ms")),
            ];
            format!("  {name}:\n    canopen: {{{}}}", written(keys))
        })
        .collect();
    let message = "a bus says its kind now, and this program is a node of it there";
    let help = format!("write in place of `{}`\n\nbuses:\n{}", former.join("`, `"), lines.join("\n"));
    let mut finding = locator.finding(Severity::Error, first, message.to_owned(), help);
    former.iter().skip(1).for_each(|key| locator.relate(&mut finding, key, "this too"));
    Some(finding)
}

/// A drive had the keys of its address beside the others.
fn drives(locator: &Locator) -> Vec<Diagnostic> {
    let drives = match locator.outline.find("drives").map(|node| &node.content) {
        Some(Content::List(drives)) => drives.as_slice(),
        _ => &[],
    };
    let finding = |(index, drive): (usize, &Node)| {
        let keys = ["node_id", "heartbeat_ms"].map(|key| (key, scalar(Some(drive), key)));
        let first = keys.iter().find(|(_, value)| value.is_some())?.0;
        let message = format!("the address of `drives[{index}]` says the kind of its bus now");
        let here = keys.iter().filter(|(_, value)| value.is_some()).map(|(key, _)| format!("`{key}`"));
        let here = here.collect::<Vec<_>>().join(" and ");
        let help = format!("write in place of {here}\n\n    address:\n      canopen: {{{}}}", written(keys));
        Some(locator.finding(Severity::Error, &format!("drives[{index}].{first}"), message, help))
    };
    (0..).zip(drives).filter_map(finding).collect()
}

/// Keys that have a value, as they stand between brackets.
fn written<const N: usize>(keys: [(&str, Option<String>); N]) -> String {
    let each = keys.into_iter().filter_map(|(key, value)| Some(format!("{key}: {}", value?)));
    each.collect::<Vec<_>>().join(", ")
}

/// What stands at a key of a group itself.
fn scalar(group: Option<&Node>, key: &str) -> Option<String> {
    match &entries(group).find(|(other, _)| *other == key)?.1.content {
        Content::Scalar(text) => Some(text.clone()),
        _ => None,
    }
}

/// What only the simulation uses stood in the rig.
fn simulation(locator: &Locator) -> Option<Diagnostic> {
    let outline = &locator.outline;
    let timings = entries(outline.find("buses")).filter_map(|(name, bus)| {
        Some((format!("buses.{name}.timing"), entries(Some(bus)).find(|(key, _)| *key == "timing")?.1))
    });
    let timings: Vec<(String, &Node)> = timings.collect();
    let top = ["plant", "scene"].into_iter().filter_map(|key| {
        let found = entries(outline.root.as_ref()).find(|(other, _)| *other == key)?;
        Some((key.to_owned(), found.1))
    });
    let keys: Vec<String> = top.chain(timings.clone()).map(|(key, _)| key).collect();
    let first = keys.first()?;
    let text = |node: Option<&Node>| match node.map(|node| &node.content) {
        Some(Content::Scalar(text)) => Some(text.clone()),
        _ => None,
    };
    let timing = text(timings.first().map(|(_, node)| *node)).map(|timing| format!(" {timing}\n"));
    let scene = text(outline.find("scene"));
    // A rig that has a simulation already, such as a variant by its base, changes something of it.
    let is_named = entries(outline.root.as_ref()).any(|(key, _)| key == "simulation");
    let indent = if is_named { 4 } else { 2 };
    let group = |path: &str| outline.find(path).map(|node| in_block_style(node, indent));
    let scene = scene.map(|path| match path.starts_with('/') || path.starts_with("builtin:") || is_named {
        true => format!(" {path}\n"),
        false => format!(" ../{path}\n"),
    });
    let parts = [
        ("timing", timing, " arbitrated\n"),
        ("arm", group("plant.arm"), " {..}\n"),
        ("drive_position_loop", group("plant.drive_position_loop"), " {..}\n"),
        ("scene", scene, " ../scenes/circle-tour.yaml\n"),
    ];
    let help = if is_named {
        let part = |(key, part, _): (&str, Option<String>, &str)| Some(format!("  {key}:{}", part?));
        let parts: String = parts.into_iter().filter_map(part).collect();
        format!("write in their place\n\nsimulation:\n{parts}")
    } else {
        let parts: String =
            parts.into_iter().map(|(key, part, usual)| format!("{key}:{}", part.unwrap_or(usual.to_owned()))).collect();
        format!("write in their place\n\nsimulation: simulations/my-arm.yaml\n\nand into that file\n\n{parts}")
    };
    let quoted: Vec<String> = keys.iter().map(|key| format!("`{key}`")).collect();
    let message = format!(
        "{} {} of an earlier version: what a real bus never uses is a document of its own now, which the rig names",
        quoted.join(", "),
        if keys.len() == 1 { "is" } else { "are" }
    );
    let mut finding = locator.finding(Severity::Error, first, message, help.trim_end().to_owned());
    keys.iter().skip(1).for_each(|key| locator.relate(&mut finding, key, "this too"));
    Some(finding)
}

fn entries(node: Option<&Node>) -> impl Iterator<Item = (&str, &Node)> {
    let entries = match node.map(|node| &node.content) {
        Some(Content::Map(entries)) => entries.as_slice(),
        _ => &[],
    };
    entries.iter().map(|(key, node)| (key.as_str(), node))
}
