//! The admittance rig on CANopen servo drives.

use std::collections::BTreeMap;
use std::sync::Arc;

use garde::{Path, Report, Validate};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use yieldwall_drives::cia402::CommandMode;
use yieldwall_drives::profiles::{DeviceProfile, EncoderKind, Fieldbus};

use super::arm::{ArmInertia, Linkage};
use super::fixture::Fixture;
use super::profile::{Fitting, ProfileName, is_yaml};
use super::sensor::Sensor;
use super::simulation::{BusTiming, NotSimulated, Simulation, named_simulation};
use super::waits::{Waits, enabling_ms};
use crate::injection::{DefectKind, Injection, Medium, Target};
use crate::number::{Finite, NotNegative, Positive, nullable, present};

/// An admittance rig: five-bar arm, two servo drives, force sensor, virtual fixture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Rig {
    /// Name of the rig and command mode of its drives.
    #[garde(dive)]
    pub rig: RigIdentity,
    /// Timing of the control.
    #[garde(dive)]
    pub cycle: Cycle,
    /// Buses by name. Drives and sensor refer to these names; each bus has at least one device. A fault on one bus stops all
    /// devices.
    #[garde(length(min = 1), dive)]
    pub buses: BTreeMap<String, Bus>,
    /// The servo drives: first the drive of the left arm, then the drive of the right arm.
    #[garde(dive)]
    pub drives: [Drive; 2],
    /// The six-axis force sensor.
    #[garde(dive)]
    pub sensor: Sensor,
    /// Geometry of the five-bar arm.
    #[garde(dive)]
    pub linkage: Linkage,
    /// Joint controllers.
    #[garde(dive)]
    pub control: Control,
    /// The virtual fixture; its coupling is `admittance`, its surface lies in the plane.
    #[garde(dive)]
    pub fixture: Fixture,
    /// Limits at which the rig holds or stops.
    #[garde(dive)]
    pub guard: Guard,
    /// Machine model of the simulation, and its scene: a file, relative to this file, or the content of such a file. A real bus
    /// uses nothing of it. Left out: the rig cannot be simulated.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(schema_with = "named_simulation")]
    pub simulation: Option<Simulation>,
}

impl Rig {
    /// The simulation.
    ///
    /// # Errors
    /// If the rig has none.
    pub fn simulated(&self) -> Result<&Simulation, NotSimulated> {
        self.simulation.as_ref().ok_or(NotSimulated)
    }

    /// Whether frames take time on the buses: always, unless a simulation says otherwise.
    pub fn frames_take_time(&self) -> bool {
        self.simulation.as_ref().is_none_or(|simulation| simulation.timing == BusTiming::Arbitrated)
    }

    /// Whether one of its buses is a CAN bus.
    pub fn is_on_can(&self) -> bool {
        self.buses.values().any(|bus| bus.canopen().is_some())
    }

    /// Whether one of its buses is an EtherCAT segment.
    pub fn is_on_ethercat(&self) -> bool {
        self.buses.values().any(|bus| matches!(bus, Bus::Ethercat(_)))
    }

    /// The EtherCAT segment that the drives are on.
    pub fn segment_of_drives(&self) -> Option<EthercatBus> {
        match self.buses.get(&self.drives[0].bus) {
            Some(Bus::Ethercat(bus)) => Some(*bus),
            _ => None,
        }
    }

    /// The device model of a drive, with the objects and the process data of its axis.
    pub fn model(&self, drive: &Drive) -> Option<Arc<DeviceProfile>> {
        let axis = drive.address.axis().unwrap_or_default();
        let before = |other: &&Drive| drive.shares_device(other) && other.address.axis().unwrap_or_default() < axis;
        let rank = self.drives.iter().filter(before).count() as u8;
        Some(drive.profile.get()?.of_axis(axis, rank, drive.address.fieldbus()))
    }

    /// Whether both drives are axes of one device.
    pub fn has_one_device(&self) -> bool {
        let [left, right] = &self.drives;
        left.shares_device(right)
    }

    /// Whether the drives are on an EtherCAT segment.
    pub fn has_drives_on_ethercat(&self) -> bool {
        self.drives.iter().any(|drive| drive.address.position().is_some())
    }

    /// Returns the reason why no machine of this rig can have a defect, and the kind of rig that can; `None` if this rig can.
    pub fn excludes(&self, defect: DefectKind) -> Option<[&'static str; 2]> {
        match defect {
            DefectKind::HeartbeatConsumerOff if self.has_drives_on_ethercat() => {
                Some(["drives on EtherCAT watch no heartbeat", "a rig whose drives are on CAN"])
            }
            DefectKind::LooseHome if self.drives.iter().any(|drive| drive.homing.is_none()) => {
                Some(["its drives are not homed", "a rig with `homing`, such as builtin:paper-incremental.yaml"])
            }
            _ => None,
        }
    }

    /// Returns the kind of bus on which an injection acts.
    pub fn medium(&self, injection: &Injection) -> Medium {
        let [left, right] = self.drives.each_ref().map(|drive| drive.address.position().is_some());
        let is_on_segment = [left, right, self.sensor.protocol.position().is_some()];
        injection.medium(|device| is_on_segment.get(device) == Some(&true))
    }

    /// Returns the kinds of bus on which an injection acts: both, if it acts at the interfaces of the master to all buses.
    pub fn media(&self, injection: &Injection) -> impl Iterator<Item = Medium> {
        let medium = self.medium(injection);
        let has_both = self.is_on_can() && self.is_on_ethercat() && injection.target == Target::Link;
        let other = Some(Medium::Can).filter(|can| has_both && *can != medium);
        [medium].into_iter().chain(other).filter(|medium| injection.kind.row().media.contains(medium))
    }

    /// This program as a node of the first CAN bus. The other CAN buses use the same node settings.
    pub fn own_node(&self) -> Option<CanBus> {
        self.buses.values().find_map(Bus::canopen)
    }

    /// The simulation, to change it.
    ///
    /// # Errors
    /// If the rig has none.
    pub fn simulated_mut(&mut self) -> Result<&mut Simulation, NotSimulated> {
        self.simulation.as_mut().ok_or(NotSimulated)
    }
}

/// The device profile that a file named by a rig holds.
type NamedFile = std::sync::Arc<yieldwall_drives::profiles::DeviceProfile>;

/// A place where a document names a device model: the key, the name, and the kind of the models that fit there.
pub(crate) type NamedProfile<'a> = (&'static str, &'a mut ProfileName, Fitting);

impl Rig {
    /// Gives new names to device profiles that are files, so that they can lie beside this document. Returns names and profiles.
    pub fn name_profile_files(&mut self) -> Vec<(String, NamedFile)> {
        let mut named: Vec<(String, NamedFile)> = Vec::new();
        for (_, name, _) in self.profiles_mut() {
            let Some(profile) = name.get().filter(|_| name.is_file()) else { continue };
            // A file of error codes does not lie beside it, and nothing that runs needs one.
            let mut profile = (**profile).clone();
            profile.profile.error_codes = profile.profile.error_codes.filter(|codes| !is_yaml(codes));
            let profile = std::sync::Arc::new(profile);
            let known = named.iter().find(|(_, known)| *known == profile).map(|(known, _)| known.clone());
            let new = known.unwrap_or_else(|| {
                let new = format!("profile-{}.yaml", named.len() + 1);
                named.push((new.clone(), profile.clone()));
                new
            });
            name.rename(new);
        }
        named
    }

    /// Replaces the file names of device profiles.
    pub fn rename_profile_files(&mut self, renamed: impl Fn(&str) -> String) {
        for (_, name, _) in self.profiles_mut().into_iter().filter(|(_, name, _)| name.is_file()) {
            name.rename(renamed(name.as_str()));
        }
    }

    /// Returns the file names of its device profiles as the document writes them.
    pub fn profile_files(&self) -> impl Iterator<Item = &str> {
        let of_sensor = self.sensor.protocol.profile();
        let named = self.drives.iter().map(|drive| &drive.profile).chain(of_sensor);
        named.filter(|name| name.is_file()).map(ProfileName::as_str)
    }

    /// Returns the device models that it names.
    pub(crate) fn profiles_mut(&mut self) -> Vec<NamedProfile<'_>> {
        let [left, right] = &mut self.drives;
        let of_drive = |address: &Address| Fitting::on(true, address.position().is_some());
        let of_sensor = Fitting::on(false, self.sensor.protocol.position().is_some());
        let mut named = vec![
            ("drives[0].profile", &mut left.profile, of_drive(&left.address)),
            ("drives[1].profile", &mut right.profile, of_drive(&right.address)),
        ];
        if let Some((key, profile)) = self.sensor.protocol.profile_mut() {
            named.push((key, profile, of_sensor));
        }
        if let Some(model) = self.simulation.as_mut().and_then(|simulation| simulation.drive_model.as_mut()) {
            named.push(("simulation.drive_model.profile", &mut model.profile, Fitting::SERVO));
        }
        named
    }
}

/// Identity of a rig and command mode of its drives.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct RigIdentity {
    /// Name for reports and figures.
    #[garde(length(min = 1))]
    pub name: String,
    /// Quantity that the rig sends to the drives in each cycle: torque (CST), velocity (CSV) or position (CSP).
    pub command_mode: CommandMode,
}

/// Timing of a control cycle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Cycle {
    /// T in us: time from one SYNC to the next. 100 to 100 000.
    #[garde(range(min = 100, max = 100_000))]
    pub period_us: u32,
    /// Start of the control step, us after SYNC: after the last TPDO, and early enough for the RPDOs to arrive before the next
    /// SYNC. Below `period_us`.
    #[garde(range(min = 1))]
    pub compute_at_us: u32,
}

/// A bus, by its kind.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Bus {
    /// A CAN bus.
    Canopen(CanBus),
    /// An EtherCAT segment.
    Ethercat(EthercatBus),
}

// Derived, the path of a finding would have the number of the field in it.
impl Validate for Bus {
    type Context = ();

    fn validate_into(&self, context: &(), parent: &mut dyn FnMut() -> Path, report: &mut Report) {
        match self {
            Self::Canopen(bus) => bus.validate_into(context, &mut || parent().join("canopen"), report),
            Self::Ethercat(bus) => bus.validate_into(context, &mut || parent().join("ethercat"), report),
        }
    }
}

impl Bus {
    /// Returns the CAN bus; `None` for another kind.
    pub fn canopen(&self) -> Option<CanBus> {
        match self {
            Bus::Canopen(bus) => Some(*bus),
            Bus::Ethercat(_) => None,
        }
    }

    /// Returns the CAN bus to change it; `None` for another kind.
    pub fn canopen_mut(&mut self) -> Option<&mut CanBus> {
        match self {
            Bus::Canopen(bus) => Some(bus),
            Bus::Ethercat(_) => None,
        }
    }
}

/// An EtherCAT segment: devices in a line behind one port of the computer. Written `{}` if outputs take effect at SYNC0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct EthercatBus {
    /// Time at which drives apply their outputs; `sync0` if left out. Drives sample their inputs at SYNC0 in both cases.
    #[serde(default, skip_serializing_if = "is_default")]
    pub outputs: OutputsAct,
}

/// Time at which the drives of a segment apply their outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OutputsAct {
    /// At the SYNC0 that follows, one cycle after the inputs from which they were computed (1C32h:01 is 2).
    #[default]
    Sync0,
    /// When they arrive, after the control step of the same cycle (1C32h:01 is 1).
    OnArrival,
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// A CAN bus, and the settings of this program as a node of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct CanBus {
    /// Bit rate, bit/s: one of the rates of CiA 301 (10000, 20000, 50000, 125000, 250000, 500000, 800000, 1000000).
    pub bit_rate_bit_per_s: u32,
    /// CANopen node-ID of this program, 1 to 127; the same on all buses.
    #[garde(range(min = 1, max = 127))]
    pub node_id: u8,
    /// Heartbeat period of this program, ms; the drives watch it. 1 to 10 000, at least two control periods; the same on all buses.
    #[garde(range(min = 1, max = 10_000))]
    pub heartbeat_ms: u16,
}

/// The address of a drive, by the kind of its bus.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Address {
    /// A node of a CANopen bus.
    Canopen(CanopenAddress),
    /// A place in an EtherCAT segment.
    Ethercat(EthercatAddress),
}

impl Validate for Address {
    type Context = ();

    fn validate_into(&self, context: &(), parent: &mut dyn FnMut() -> Path, report: &mut Report) {
        match self {
            Self::Canopen(node) => node.validate_into(context, &mut || parent().join("canopen"), report),
            Self::Ethercat(place) => place.validate_into(context, &mut || parent().join("ethercat"), report),
        }
    }
}

impl Address {
    /// Returns the node of a CANopen bus; `None` on another kind of bus.
    pub fn canopen(&self) -> Option<CanopenAddress> {
        match self {
            Address::Canopen(node) => Some(*node),
            Address::Ethercat(_) => None,
        }
    }

    /// Returns the node of a CANopen bus to change it; `None` on another kind of bus.
    pub fn canopen_mut(&mut self) -> Option<&mut CanopenAddress> {
        match self {
            Address::Canopen(node) => Some(node),
            Address::Ethercat(_) => None,
        }
    }

    /// Node-ID of a node of a CANopen bus.
    pub fn node_id(&self) -> Option<u8> {
        self.canopen().map(|node| node.node_id)
    }

    /// Heartbeat period of a node of a CANopen bus, ms.
    pub fn heartbeat_ms(&self) -> Option<u16> {
        self.canopen().map(|node| node.heartbeat_ms)
    }

    /// Place in an EtherCAT segment.
    pub fn position(&self) -> Option<u16> {
        match self {
            Address::Canopen(_) => None,
            Address::Ethercat(place) => Some(place.position),
        }
    }

    /// Axis of the device, if it is written.
    pub fn axis(&self) -> Option<u8> {
        match self {
            Address::Canopen(node) => node.axis,
            Address::Ethercat(place) => place.axis,
        }
    }

    /// The kind of bus that it is for.
    pub fn fieldbus(&self) -> Fieldbus {
        match self {
            Address::Canopen(_) => Fieldbus::Canopen,
            Address::Ethercat(_) => Fieldbus::Ethercat,
        }
    }
}

impl Drive {
    /// Whether another drive is at the same address of the same bus: another axis of one device.
    pub fn shares_device(&self, other: &Drive) -> bool {
        let place = |drive: &Drive| (drive.address.node_id(), drive.address.position());
        self.bus == other.bus && place(self) == place(other)
    }
}

/// A place in an EtherCAT segment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct EthercatAddress {
    /// Number of devices between the computer and this device. 0 for the first one; each device has its own number.
    pub position: u16,
    /// Axis of a device with several drives, whose profile has `axes`: 0 to 7. 0 if left out; if both drives are axes of one
    /// device, both need it.
    #[garde(range(max = 7))]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axis: Option<u8>,
}

/// A node of a CANopen bus.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct CanopenAddress {
    /// CANopen node-ID, 1 to 127; each node of the bus has its own.
    #[garde(range(min = 1, max = 127))]
    pub node_id: u8,
    /// Heartbeat period of the drive, ms; this program watches it. 1 to 10 000, at least two control periods.
    #[garde(range(min = 1, max = 10_000))]
    pub heartbeat_ms: u16,
    /// Axis of a device with several drives, whose profile has `axes`: 0 to 7. 0 if left out; if both drives are axes of one
    /// device, both need it.
    #[garde(range(max = 7))]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axis: Option<u8>,
}

/// A servo drive and the joint that it turns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Drive {
    /// Name for reports and messages.
    #[garde(length(min = 1))]
    pub name: String,
    /// Bus of the drive: a key of `buses`.
    pub bus: String,
    /// Address of the drive on that bus.
    #[garde(dive)]
    pub address: Address,
    /// Device model: identity, process data, watchdogs and limits.
    pub profile: ProfileName,
    /// Position counts per turn of the proximal link, gear included. Above 0.
    #[garde(range(min = 1))]
    pub encoder_counts_per_rev: u32,
    /// Kind of the encoder: how much it knows at power-on. Left out: the kind that the profile names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub encoder: Option<EncoderKind>,
    /// Homing by the drive itself. Only for an encoder that does not know its reference at power-on.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub homing: Option<Homing>,
    /// Sign of the counts for a positive angle: 1 or -1.
    pub direction: i8,
    /// Angle of the proximal link when the drive reads 0, rad.
    pub zero_offset_rad: Finite,
    /// Rated torque at the link, N m. Above 0.
    #[garde(dive)]
    pub rated_torque_n_m: Positive,
    /// Times for which the boot of the network waits for the drive. Left out: the usual times.
    #[garde(dive)]
    #[serde(default)]
    pub waits: Waits,
    /// Longest time from the enable request to Operation Enabled, ms, brakes included. 1 to 60 000; 5000 if left out.
    #[garde(range(min = 1, max = 60_000))]
    #[serde(default = "enabling_ms")]
    pub enabling_ms: u32,
}

/// Homing by the drive itself, in the homing mode of CiA 402.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Homing {
    /// Homing method: a number of 6098h that the profile has. 37 takes the present position, to which a person has moved the
    /// joint.
    pub method: i8,
    /// Angle of the proximal link at home, rad: at the index, at the edge of the switch, or in the jig. Until the drive is homed,
    /// the program assumes that its joint is there.
    pub angle_rad: Finite,
    /// Angle of the joint from one index of the encoder to the next, rad. For methods that search an index and an encoder on the
    /// motor. More than twice `within_rad`, so that the drive cannot find another index.
    #[garde(dive)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub index_every_rad: Option<Positive>,
    /// Largest distance of the joint from home at power-on, and largest distance of its search for home, rad. 0.01 to 1.5.
    #[garde(dive)]
    pub within_rad: Positive,
    /// Speed of the joint during homing, rad/s. 0.005 to 0.5.
    #[garde(dive)]
    pub rate_rad_per_s: Positive,
}

/// Joint controllers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Control {
    /// Control law of torque mode.
    pub law: ControlLaw,
    /// Gains of the controller, and the space in which it forms the error. Torque mode takes `joint` or `cartesian`, velocity
    /// mode takes `rate`. In position mode the drives close the loop, and the rig uses nothing of `control`.
    #[garde(dive)]
    pub gains: ControlGains,
    /// H in s: time constant of the sliding line of PSMC; used in torque mode. 0 or above.
    #[garde(dive)]
    pub sliding_time_s: NotNegative,
    /// Known friction and inertia of the machine, as a feed-forward term of torque mode.
    #[garde(dive)]
    pub feed_forward: FeedForward,
}

/// Control law of the joints.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ControlLaw {
    /// Proxy-based sliding mode control.
    Psmc,
    /// PID.
    Pid,
}

/// Gains of a control law, and the space in which it forms the error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub enum ControlGains {
    /// Error in joint angles.
    Joint {
        /// K in N m/rad: position gain. Above 0.
        #[garde(dive)]
        stiffness_n_m_per_rad: Positive,
        /// B in N m s/rad: velocity gain. 0 or above.
        #[garde(dive)]
        damping_n_m_s_per_rad: NotNegative,
        /// L in N m/(rad s): integral gain. 0 or above.
        #[garde(dive)]
        integral_n_m_per_rad_s: NotNegative,
    },
    /// A joint rate per angle error, added to the rate of the reference, for drives that take velocities.
    Rate {
        /// Rate per angle error, 1/s. Above 0.
        #[garde(dive)]
        gain_per_s: Positive,
    },
    /// Error at the tool.
    Cartesian {
        /// K in N/m: position gain. Above 0.
        #[garde(dive)]
        stiffness_n_per_m: Positive,
        /// B in N s/m: velocity gain. 0 or above.
        #[garde(dive)]
        damping_n_s_per_m: NotNegative,
        /// L in N/(m s): integral gain. 0 or above.
        #[garde(dive)]
        integral_n_per_m_s: NotNegative,
    },
}

/// Known friction and inertia of the machine, added to the torque. Pairs list the left arm before the right.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct FeedForward {
    /// Coulomb friction of each joint, N m. 0 or above.
    #[garde(dive)]
    pub coulomb_n_m: [NotNegative; 2],
    /// Viscous friction of each joint, N m s/rad. 0 or above.
    #[garde(dive)]
    pub viscous_n_m_s_per_rad: [NotNegative; 2],
    /// Inertia of the arm; null switches the inertia term off.
    #[garde(dive)]
    #[serde(deserialize_with = "present")]
    #[schemars(schema_with = "nullable::<ArmInertia>")]
    pub inertia: Option<ArmInertia>,
}

/// Limits at which the rig holds or stops.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Validate)]
#[serde(deny_unknown_fields)]
#[garde(allow_unvalidated)]
pub struct Guard {
    /// Largest torque sent to a joint, N m. Above 0, and within the range of the drives' torque command: 32.767 times the rated
    /// torque.
    #[garde(dive)]
    pub torque_limit_n_m: Positive,
    /// Largest rate of a joint, rad/s. Above 0.
    #[garde(dive)]
    pub joint_speed_limit_rad_per_s: Positive,
    /// Largest speed of the tool, m/s. Above 0.
    #[garde(dive)]
    pub tool_speed_limit_m_per_s: Positive,
    /// Largest force of the hand, N; above it the rig stops. Above `fixture.yield_n`.
    #[garde(dive)]
    pub force_limit_n: Positive,
    /// Largest change of the hand's force from one sensor sample to the next, N. Above 0. The rig cuts a larger change to this
    /// value and holds.
    #[garde(dive)]
    pub force_step_limit_n: Positive,
    /// Largest mean difference between the torques of a joint and the torques that sensed force and motion explain, N m; above it
    /// the rig stops. Used in torque mode with an inertia in `control.feed_forward`. Above the joints' friction; null switches it
    /// off.
    #[garde(dive)]
    #[serde(deserialize_with = "present")]
    #[schemars(schema_with = "nullable::<Positive>")]
    pub residual_limit_n_m: Option<Positive>,
    /// Largest burst of energy into the hand beyond the energy that the rig stored and that moving surfaces brought, J; above it
    /// the rig holds. Above 0. The rig forgets given energy within a second.
    #[garde(dive)]
    pub energy_limit_j: Positive,
    /// Smallest distance of the tool from singular positions and from the edge of the workspace, m. Above 0.
    #[garde(dive)]
    pub singularity_margin_m: Positive,
    /// Largest distance between commanded and measured angle, rad; the drives' own limit is twice this value. Above 0.
    #[garde(dive)]
    pub following_error_limit_rad: Positive,
    /// Largest deceleration of the ramp along which the rig stops, m/s^2. Above 0.
    #[garde(dive)]
    pub stop_deceleration_m_per_s2: Positive,
}
