//! `yieldwall faults`, `run --fault` and `sim --fault`: the faults that can be injected on the embedded simulation and on a
//! simulated segment.

use std::str::FromStr;

use serde_json::json;

use super::failure::{Exit, Failure};
use super::fit;
use super::output::Output;
use yieldwall_config as config;
use yieldwall_config::injection::{
    CATALOGUE, CatalogueRow, Ending, Expected, Injection, Kind, Lasts, Recovery, Target,
};

/// Argument `--fault NAME@TIME[+DURATION][:TARGET]`.
#[derive(Clone, Debug)]
pub(super) struct FaultArgument {
    injection: Injection,
    /// Whether it says where.
    has_target: bool,
    /// A target that only a rig knows: one of its devices.
    device: Option<String>,
}

impl FaultArgument {
    /// Returns the name of the fault.
    pub(super) fn name(&self) -> &'static str {
        self.injection.kind.row().name
    }

    /// Returns the injection, with a device's name in the rig resolved to its kind. Without a target, it applies to the first
    /// target of its kind on such a bus, if there is one.
    pub(super) fn of_rig(&self, rig: &config::Rig) -> Result<Injection, Failure> {
        let Some(device) = &self.device else {
            let fits = at_first_target(self.injection, rig);
            return Ok(fits.filter(|_| !self.has_target).unwrap_or(self.injection));
        };
        let [left, right] = &rig.drives;
        let devices =
            [(&left.name, Target::LeftDrive), (&right.name, Target::RightDrive), (&rig.sensor.name, Target::Sensor)];
        let name = self.name();
        let refused =
            |message: String, help: String| Failure::new(Exit::Usage, format!("--fault {name}: {message}"), help);
        if let Some((_, target)) = devices.iter().find(|(known, _)| *known == device) {
            let injection = self.injection.on(*target);
            return injection.check().map(|()| injection).map_err(|error| refused(error.to_string(), String::new()));
        }
        let known: Vec<&str> =
            devices.iter().map(|(name, _)| name.as_str()).chain(Target::NAMES.map(|(_, name)| name)).collect();
        let help = match config::nearest_word(device, known.iter().copied()) {
            Some(meant) => format!("did you mean {meant}?"),
            None => format!("write one of {}", known.join(", ")),
        };
        Err(refused(format!("there is no device and no target {device}"), help))
    }
}

/// Returns the injection at the first target of its kind on such a bus, if there is one.
pub(super) fn at_first_target(injection: Injection, rig: &config::Rig) -> Option<Injection> {
    let mut usual = injection.kind.row().targets.iter().map(|target| injection.on(*target));
    usual.find(|injection| injection.check_on(rig.medium(injection)).is_ok())
}

impl FromStr for FaultArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (rest, target) = match text.split_once(':') {
            Some((rest, target)) => (rest, Some(target)),
            None => (text, None),
        };
        let (name, times) = match rest.split_once('@') {
            Some((name, times)) => (name, Some(times)),
            None => (rest, None),
        };
        let kind = kind(name)?;
        let seconds = |text: &str, what: &str| {
            text.parse::<f64>().map_err(|_| format!("{what} {text} is not a number of seconds, such as 1.5"))
        };
        let mut injection = match times {
            None if kind.row().lasts == Lasts::FromBoot => Injection::new(kind, 0.0),
            None => return Err(format!("add a time: {name}@1.5 begins 1.5 s after the start of the scene")),
            Some(times) => {
                let (start, duration) = match times.split_once('+') {
                    Some((start, duration)) => (start, Some(duration)),
                    None => (times, None),
                };
                let injection = Injection::new(kind, seconds(start, "the time")?);
                match duration {
                    Some(duration) => injection.lasting(Some(seconds(duration, "the duration")?)),
                    None => injection,
                }
            }
        };
        let named = target.and_then(Target::named);
        if let Some(target) = named {
            injection = injection.on(target);
        }
        let device = target.filter(|_| named.is_none()).map(str::to_owned);
        let has_target = target.is_some();
        injection.check().map(|()| Self { injection, has_target, device }).map_err(|error| error.to_string())
    }
}

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Faults to describe in full; default: one line for each fault
    #[arg(value_name = "NAME", value_parser = parse_row)]
    names: Vec<&'static CatalogueRow>,
}

fn parse_row(name: &str) -> Result<&'static CatalogueRow, String> {
    kind(name).map(Kind::row)
}

fn kind(name: &str) -> Result<Kind, String> {
    Kind::named(name).ok_or_else(|| {
        let known = CATALOGUE.iter().map(|row| row.name);
        match config::nearest_word(name, known) {
            Some(meant) => format!("no fault is named {name}: did you mean {meant}?"),
            None => format!("there is no fault {name}: `yieldwall faults` lists them"),
        }
    })
}

/// Prints the catalogue, or its text on some faults.
pub(super) fn list(arguments: &Arguments, output: &mut Output) -> Result<(), Failure> {
    let is_all = arguments.names.is_empty();
    let rows: Vec<&CatalogueRow> = if is_all { CATALOGUE.iter().collect() } else { arguments.names.clone() };
    if output.is_json() {
        return output.report(json!({ "faults": rows.into_iter().map(document).collect::<Vec<_>>() }));
    }
    if is_all {
        let widest = rows.iter().map(|row| row.name.len()).max().unwrap_or_default() + 2;
        let indent = " ".repeat(widest);
        let lines: String = rows
            .iter()
            .map(|row| fit::filled(&format!("{:widest$}", row.name), &indent, row.meaning, fit::USUAL) + "\n")
            .collect();
        return output.result(&(lines + "\n`yieldwall faults NAME` prints targets, duration and consequence.\n"));
    }
    let lines: Vec<String> = rows.into_iter().map(text).collect();
    output.result(&(lines.join("\n\n") + "\n"))
}

fn targets(row: &CatalogueRow) -> String {
    row.targets.iter().map(|target| target.name()).collect::<Vec<_>>().join(", ")
}

fn media(row: &CatalogueRow) -> Vec<&'static str> {
    row.media.iter().map(|medium| medium.name()).collect()
}

fn fault_names(expected: &Expected) -> Vec<&'static str> {
    expected.faults.iter().map(|fault| fault.row().name).collect()
}

fn duration(row: &CatalogueRow) -> String {
    match row.lasts {
        Lasts::Once => "once".to_owned(),
        Lasts::For(duration_s) => format!("{duration_s} s"),
        Lasts::Stays => "to the end".to_owned(),
        Lasts::FromBoot => "from switching on".to_owned(),
    }
}

fn ending(expected: &Expected) -> String {
    let faults = listed(&fault_names(expected));
    match expected.ending {
        Ending::GoesOn if faults.is_empty() => "the rig continues".to_owned(),
        Ending::GoesOn => format!("counted as {faults}; the rig continues"),
        Ending::Latched(states) => {
            let states: Vec<String> = states.iter().map(|state| format!("{state:?}")).collect();
            format!("{faults} stops the rig ({})", listed(&states))
        }
        Ending::NotEnabled if faults.is_empty() => "the boot refuses the device".to_owned(),
        Ending::NotEnabled => format!("{faults} prevents the rig from running"),
        Ending::DrivesStop => "the drives stop by their own watchdogs".to_owned(),
    }
}

fn recovery(expected: &Expected) -> &'static str {
    match expected.recovery {
        Recovery::None => "",
        Recovery::Reset => "; reset and enable to continue",
        Recovery::Restart => "; restart to continue",
        Recovery::NewProcess => "; start a new process to continue",
    }
}

/// Returns names as "a, b or c".
fn listed<T: AsRef<str>>(names: &[T]) -> String {
    let names: Vec<&str> = names.iter().map(AsRef::as_ref).collect();
    match names.as_slice() {
        [first @ .., before, last] => [first, &[&format!("{before} or {last}")]].concat().join(", "),
        names => names.concat(),
    }
}

/// Returns the consequence of the fault; if it differs between the buses, a line for each.
pub(super) fn consequence(row: &CatalogueRow) -> String {
    let result = |expected| format!("{}{}", ending(expected), recovery(expected));
    match &row.on_ethercat {
        None => result(&row.expected),
        Some(other) => format!("on CAN: {}\non EtherCAT: {}", result(&row.expected), result(other)),
    }
}

fn text(row: &CatalogueRow) -> String {
    let size = row.size.map(|size| format!("{}, default {}", size.what, size.usual));
    let facts = [
        ("fault", Some(row.name.to_owned())),
        ("effect", Some(row.meaning.to_owned())),
        ("targets", Some(targets(row))),
        ("bus", Some(media(row).join(" and "))),
        ("duration", Some(duration(row))),
        ("size", size),
        ("result", Some(consequence(row))),
    ];
    let lines = facts.iter().filter_map(|(label, text)| Some((label, text.as_deref()?))).flat_map(|(label, text)| {
        let labels = std::iter::once(*label).chain(std::iter::repeat(""));
        labels
            .zip(text.lines())
            .map(|(label, line)| fit::filled(&format!("{label:9} "), "          ", line, fit::USUAL))
    });
    lines.collect::<Vec<_>>().join("\n")
}

fn document(row: &CatalogueRow) -> serde_json::Value {
    let mut document = follows(&row.expected);
    document["name"] = row.name.into();
    document["meaning"] = row.meaning.into();
    document["targets"] = row.targets.iter().map(|target| target.name()).collect();
    document["on"] = media(row).into();
    document["lasts"] = duration(row).into();
    document["size"] = json!(row.size.map(|size| json!({
        "what": size.what, "usual": size.usual, "least": size.least, "most": size.most,
    })));
    document["matrix"] = row.matrix.into();
    document["on_ethercat"] = json!(row.on_ethercat.map(follows));
    document
}

fn follows(expected: &Expected) -> serde_json::Value {
    json!({
        "faults": fault_names(expected),
        "reaction": format!("{:?}", expected.reaction),
        "ending": ending(expected),
        "recovery": format!("{:?}", expected.recovery),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Injection, String> {
        text.parse::<FaultArgument>().map(|argument| argument.injection)
    }

    #[test]
    fn a_consequence_has_a_line_for_each_bus() {
        assert_eq!([listed::<&str>(&[]), listed(&["a"]), listed(&["a", "b"])], ["", "a", "a or b"]);
        assert_eq!(listed(&["a", "b", "c"]), "a, b or c");
        let text = consequence(Kind::NodeReset.row());
        assert!(text.starts_with("on CAN: node-reset, ") && text.contains("\non EtherCAT: "), "{text}");
    }

    #[test]
    fn a_target_may_be_a_device_of_the_rig() {
        let rig = config::load_rig(config::builtin("paper-admittance.yaml")).unwrap().value;
        let of_rig = |text: &str| text.parse::<FaultArgument>().unwrap().of_rig(&rig);
        let reset = |target| Injection::new(Kind::NodeReset, 2.0).on(target);
        for (device, target) in
            [("left", Target::LeftDrive), ("right_drive", Target::RightDrive), ("wrist", Target::Sensor)]
        {
            assert_eq!(of_rig(&format!("node-reset@2:{device}")).unwrap(), reset(target), "{device}");
        }
        for (text, says, helps) in [
            ("node-reset@2:lefft", "no device and no target lefft", "did you mean left?"),
            ("pdo-lost@1:wrist", "it acts on left_drive, right_drive", ""),
            ("node-reset@2:elbow", "no device and no target elbow", "write one of left, right, wrist, left_drive"),
        ] {
            let finding = of_rig(text).unwrap_err().report.diagnostics.remove(0);
            assert!(finding.message.contains(says), "{}", finding.message);
            assert!(finding.help.unwrap_or_default().contains(helps), "{text}");
        }
    }

    #[test]
    fn without_a_target_it_is_where_the_rig_has_such_a_bus() {
        let rig = config::load_rig(config::builtin("paper-ethercat-can-sensor.yaml")).unwrap().value;
        let target = |text: &str| text.parse::<FaultArgument>().unwrap().of_rig(&rig).unwrap().target;
        assert_eq!(target("heartbeat-silent@2"), Target::Sensor);
        assert_eq!(target("heartbeat-silent@2:left_drive"), Target::LeftDrive);
        assert_eq!(target("device-state@2"), Target::LeftDrive);
        assert_eq!(target("pdo-lost@2"), Target::LeftDrive);
    }

    #[test]
    fn names_times_durations_and_targets_are_read() {
        let stuck = Injection::new(Kind::SensorStuck, 1.5);
        assert_eq!(parse("sensor-stuck@1.5"), Ok(stuck));
        assert_eq!(parse("sensor-stuck@1.5+0.2"), Ok(stuck.lasting(Some(0.2))));
        let lost = Injection::new(Kind::PdoLost, 2.0).lasting(Some(0.05)).on(Target::RightDrive);
        assert_eq!(parse("pdo-lost@2+0.05:right_drive"), Ok(lost));
        assert_eq!(parse("identity-mismatch"), Ok(Injection::new(Kind::IdentityMismatch, 0.0)));
    }

    #[test]
    fn what_cannot_be_read_is_answered_with_what_to_write() {
        for (text, answer) in [
            ("sensor-stick@1", "did you mean sensor-stuck?"),
            ("xyzzy@1", "`yieldwall faults` lists them"),
            ("sensor-stuck", "add a time: sensor-stuck@1.5"),
            ("sensor-stuck@soon", "soon is not a number of seconds"),
            ("sensor-stuck@1+x", "x is not a number of seconds"),
            ("sensor-stuck@-1", "0 or above"),
            ("sensor-stuck@NaN", "0 or above"),
            ("sensor-stuck@1+0", "above 0"),
            ("drive-fault@1+1", "has no duration"),
            ("pdo-lost@1:sensor", "it acts on left_drive, right_drive"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(answer), "{text}: {error}");
        }
    }
}
