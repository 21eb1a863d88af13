//! `--bus`: which interface is which bus of the rig.

use super::failure::{Exit, Failure};
use yieldwall_config as config;

/// The interfaces of a rig's buses, in the order of the buses' names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Interfaces(Vec<String>);

impl Interfaces {
    /// From arguments such as `main=can0`, or `can0` alone for a rig with one bus.
    pub(super) fn of(rig: &config::Rig, arguments: &[String]) -> Result<Self, Failure> {
        let names: Vec<&str> = rig.buses.keys().map(String::as_str).collect();
        let usage = |message: String, help: String| Failure::new(Exit::Usage, message, help);
        let all = || names.iter().map(|name| format!("--bus {name}=INTERFACE")).collect::<Vec<_>>().join(" ");
        let mut interfaces: Vec<Option<&str>> = vec![None; names.len()];
        for argument in arguments {
            let (at, interface) = match (argument.split_once('='), names.len()) {
                (Some((name, interface)), _) => {
                    let at = names.iter().position(|known| *known == name).ok_or_else(|| {
                        let message = format!("--bus {argument} names the bus `{name}`, which the rig does not have");
                        usage(message, format!("its buses are {}", names.join(", ")))
                    })?;
                    (at, interface)
                }
                (None, 1) => (0, argument.as_str()),
                (None, several) => {
                    let message = format!("--bus {argument} does not say which of the rig's {several} buses it is");
                    return Err(usage(message, format!("write {}", all())));
                }
            };
            if interfaces.contains(&Some(interface)) {
                let message = format!("--bus {argument}: {interface} is given twice");
                return Err(usage(message, "give each bus an interface of its own".to_owned()));
            }
            let place = interfaces.get_mut(at).filter(|place| place.is_none());
            let again = || match names.as_slice() {
                [_] => usage("the rig has one bus".to_owned(), "give --bus once".to_owned()),
                _ => usage(format!("--bus {argument}: the bus has an interface already"), format!("write {}", all())),
            };
            *place.ok_or_else(again)? = Some(interface);
        }
        let each = names.iter().zip(interfaces).map(|(name, interface)| {
            let missing = || usage(format!("the rig's bus `{name}` has no interface"), format!("write {}", all()));
            interface.map(str::to_owned).ok_or_else(missing)
        });
        each.collect::<Result<_, _>>().map(Self)
    }

    /// Returns the interface of a single bus of the rig.
    pub(super) fn one(rig: &config::Rig, arguments: &[String], bus: &str) -> Result<String, Failure> {
        let of_bus = |argument: &String| argument.split_once('=').is_some_and(|(name, _)| name == bus);
        let mut own = rig.clone();
        own.buses.retain(|name, _| name == bus);
        let arguments: Vec<String> = match arguments.iter().any(of_bus) {
            true => arguments.iter().filter(|argument| of_bus(argument)).cloned().collect(),
            false => arguments.to_vec(),
        };
        Ok(Self::of(&own, &arguments)?.0.concat())
    }

    /// Returns the names of the interfaces.
    pub(super) fn names(&self) -> &[String] {
        &self.0
    }

    /// Returns all of them, for a person: `main=can0, sensor=can1`, or the only one.
    pub(super) fn shown(&self, rig: &config::Rig) -> String {
        if let [only] = self.0.as_slice() {
            return only.clone();
        }
        let each = rig.buses.keys().zip(&self.0).map(|(name, interface)| format!("{name}={interface}"));
        each.collect::<Vec<_>>().join(", ")
    }

    /// Returns each as `NAME=INTERFACE`.
    pub(super) fn named(&self, rig: &config::Rig) -> Vec<String> {
        rig.buses.keys().zip(&self.0).map(|(name, interface)| format!("{name}={interface}")).collect()
    }

    /// Returns the equivalent arguments.
    pub(super) fn arguments(&self, rig: &config::Rig) -> String {
        if let [only] = self.0.as_slice() {
            return format!("--bus {only}");
        }
        let each = rig.buses.keys().zip(&self.0).map(|(name, interface)| format!("--bus {name}={interface}"));
        each.collect::<Vec<_>>().join(" ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_config::{builtin, load_rig};

    fn of(rig: &str, arguments: &[&str]) -> Result<Vec<String>, String> {
        let rig = load_rig(builtin(rig)).unwrap().value;
        let arguments: Vec<String> = arguments.iter().map(|argument| (*argument).to_owned()).collect();
        let interfaces = Interfaces::of(&rig, &arguments);
        interfaces.map(|interfaces| interfaces.0).map_err(|failure| failure.report.diagnostics[0].message.clone())
    }

    #[test]
    fn a_lone_interface_is_that_of_the_only_bus() {
        assert_eq!(of("paper-admittance.yaml", &["can0"]), Ok(vec!["can0".to_owned()]));
        assert_eq!(of("paper-admittance.yaml", &["main=can0"]), Ok(vec!["can0".to_owned()]));
    }

    #[test]
    fn several_are_named_in_any_order() {
        let two = of("paper-admittance-two-buses.yaml", &["sensor=can1", "main=can0"]);
        assert_eq!(two, Ok(vec!["can0".to_owned(), "can1".to_owned()]));
    }

    #[test]
    fn what_does_not_fit_the_buses_is_refused() {
        let two = "paper-admittance-two-buses.yaml";
        for (rig, arguments, says) in [
            ("paper-admittance.yaml", &["mian=can0"][..], "names the bus `mian`"),
            ("paper-admittance.yaml", &["can0", "can1"], "the rig has one bus"),
            (two, &["can0"], "does not say which of the rig's 2 buses"),
            (two, &["main=can0"], "the rig's bus `sensor` has no interface"),
            (two, &["main=can0", "sensor=can0"], "can0 is given twice"),
            (two, &["main=can0", "main=can1"], "has an interface already"),
        ] {
            let refused = of(rig, arguments).unwrap_err();
            assert!(refused.contains(says), "{refused}");
        }
    }
}
