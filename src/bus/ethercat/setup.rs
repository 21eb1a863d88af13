//! Setup of a segment for the master.

use crate::error::BootFailure;
use crate::sample::SampleCodec;
use crate::script::{self, Action, ScriptPlan, Step, unit};
use crate::setup::{BrakeWords, HomingOrder, SensorStart, Waits};
use std::sync::Arc;
use std::time::Duration;
use yieldwall_drives::cia402::CommandMode;
use yieldwall_drives::profiles::{AxisOffset, DeviceProfile, Identity, MappedObject, MappedPdo, Quantity};
use yieldwall_fieldbus::canopen::{BusId, MappingEntry};
use yieldwall_fieldbus::objects::Address;
use yieldwall_motion::guard::{Device, DeviceSet};

/// Objects that a mapping holds at most, and mappings that are exchanged.
pub(super) const MOST_ENTRIES: u8 = 254;

/// One EtherCAT segment and the devices of a rig on it.
#[derive(Clone, Debug)]
pub struct SegmentSetup {
    /// Bus of the segment in the rig.
    pub bus: BusId,
    /// Cycle time, which is that of SYNC0 too.
    pub period: Duration,
    /// Time from the input frame to the computation.
    pub compute_at: Duration,
    /// Time from SYNC0 to the moment at which the input frame passes the reference clock.
    pub sync0_phase: Duration,
    /// The devices of the rig. Others may be on the segment; nothing is asked of them but their ports.
    pub stations: Vec<StationSetup>,
}

/// When a device has outputs act, and takes inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Acts {
    /// Both at SYNC0, by its distributed clock.
    AtSync0,
    /// Outputs act when they arrive; inputs are those of SYNC0.
    OnArrival,
    /// Without SYNC0, as the device does it by itself; nothing of its synchronisation is written.
    ByItself,
}

impl Acts {
    /// Values of 1C32h:01 and 1C33h:01, the types of synchronisation of outputs and inputs: 1 with the outputs, 2 with SYNC0.
    const fn sync_types(self) -> Option<[u32; 2]> {
        match self {
            Acts::AtSync0 => Some([2, 2]),
            Acts::OnArrival => Some([1, 2]),
            Acts::ByItself => None,
        }
    }
}

/// One device.
#[derive(Clone, Debug)]
pub struct StationSetup {
    /// Name for messages.
    pub name: String,
    /// Devices of the rig at this position: one, or drives that are axes of one device.
    pub devices: DeviceSet,
    /// Position on the segment, 0 at the master.
    pub position: u16,
    /// The alias that its SII has to have, if one was given to it.
    pub alias: Option<u16>,
    /// The serial number that it has to have, if one is known.
    pub serial: Option<u32>,
    /// Identity that the device reports.
    pub identity: Identity,
    /// How long it is waited for.
    pub waits: Waits,
    /// When it acts.
    pub acts: Acts,
    /// Time from SYNC0 to SYNC1, of a device that wants both.
    pub sync1: Option<Duration>,
    /// Process data that the master sends.
    pub outputs: Vec<ProcessData>,
    /// Process data that it sends.
    pub inputs: Vec<ProcessData>,
    /// The output that takes the target, of a drive.
    pub set_point: Option<Quantity>,
    /// Its part as the left and as the right drive.
    pub axes: [StationAxis; 2],
    /// Meaning of the bits of a sensor's inputs.
    pub codec: SampleCodec,
    /// Objects that are read and written before process data are mapped.
    pub(super) steps: Vec<Step>,
}

/// A device as one of the drives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StationAxis {
    /// Its digital outputs, of a drive whose brake the master holds.
    pub brake: Option<BrakeWords>,
    /// Distances of the objects of its axis.
    pub offset: AxisOffset,
}

/// One process data object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProcessData {
    /// Device of the rig that the PDO belongs to.
    pub device: Device,
    /// Index of its mapping, 1600h to 17FFh or 1A00h to 1BFFh.
    pub index: u16,
    /// Whether the mapping is fixed in the device: the master then only compares it.
    pub is_fixed: bool,
    /// Objects in the mapping.
    pub entries: Vec<Mapped>,
}

/// One object in process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mapped {
    /// The object.
    pub at: Address,
    /// Its bits: 1 to 32, or any number if it is nothing to the rig.
    pub bits: u8,
    /// Its meaning to the rig, if any.
    pub quantity: Option<Quantity>,
    /// The value of an output that is nothing to the rig.
    pub value: i32,
}

/// A servo drive on a segment.
#[derive(Clone, Debug)]
pub struct SegmentDrive {
    /// Name for messages.
    pub name: String,
    /// Device of the rig.
    pub device: Device,
    /// Position on the segment, 0 at the master.
    pub position: u16,
    /// Device model.
    pub profile: Arc<DeviceProfile>,
    /// How long it is waited for.
    pub waits: Waits,
    /// Torque limit that the drive is given, in per mille of its rated torque.
    pub torque_limit_per_mille: u16,
    /// Speed limit that the drive is given where it heeds one, in counts/s.
    pub speed_limit_counts_per_s: u32,
    /// Following error window that the drive is given, in counts.
    pub following_error_counts: u32,
    /// How it homes, if it is brought up for that; in the command mode of the rig otherwise.
    pub homing: Option<HomingOrder>,
}

impl SegmentDrive {
    /// The drive as a device of a segment: identity, option codes, cycle time, mode, limits and process data are those of its profile.
    ///
    /// # Errors
    /// If the profile is not a drive's profile, if it lacks the process data of the mode, or if the device cannot represent the
    /// cycle time.
    pub fn station(&self, mode: CommandMode, period: Duration, acts: Acts) -> Result<StationSetup, BootFailure> {
        let operation = script::operation(mode, self.homing);
        let profile = &*self.profile;
        let servo = script::servo(profile)?;
        let mut steps = script::identity(profile);
        steps.push(script::has_mode(servo, operation));
        script::homing(profile, servo, self.homing, &mut steps)?;
        script::settings(servo, &servo.option_codes.lost_master, &mut steps);
        script::brake(servo, &mut steps);
        script::mode(servo, operation, period.as_micros() as u32, &mut steps)?;
        let (speed, window) = (self.speed_limit_counts_per_s, self.following_error_counts);
        script::limits(servo, self.torque_limit_per_mille, speed, window, &mut steps);
        let [rpdo, tpdo] = script::pdos(profile, Some(mode.operation_mode()))?;
        let of_drive = |pdos: &[MappedPdo], first| process_data(self.device, pdos, first, &steps);
        let (outputs, inputs) = (of_drive(&rpdo, 0x1600), of_drive(&tpdo, 0x1a00));
        let needed = [Quantity::Controlword, mode.set_point(), Quantity::Statusword, Quantity::PositionActual];
        for quantity in needed {
            let mut mapped = outputs.iter().chain(&inputs).flat_map(|pdo| &pdo.entries);
            if !mapped.any(|entry| entry.quantity == Some(quantity)) {
                return Err(script::lacking(profile, quantity.word()));
            }
        }
        let is_sent =
            |quantity| outputs.iter().flat_map(|pdo| &pdo.entries).any(|entry| entry.quantity == Some(quantity));
        if servo.brake.of_master().is_some() && !is_sent(Quantity::DigitalOutputs) {
            return Err(script::lacking(profile, Quantity::DigitalOutputs.word()));
        }
        Ok(StationSetup {
            name: self.name.clone(),
            devices: self.device.set(),
            position: self.position,
            alias: None,
            serial: None,
            identity: profile.identity.clone(),
            waits: self.waits,
            acts,
            sync1: servo.sync1_us.map(|us| Duration::from_micros(us.into())),
            outputs,
            inputs,
            set_point: Some(mode.set_point()),
            axes: Device::DRIVES.map(|device| match device == self.device {
                true => StationAxis { brake: BrakeWords::of(servo), offset: profile.offset() },
                false => StationAxis::default(),
            }),
            codec: SampleCodec::default(),
            steps,
        })
    }
}

/// PDOs as process data; `first` is the mapping of number 1. Objects that are nothing to the rig get the values that the boot writes to them.
fn process_data(device: Device, pdos: &[MappedPdo], first: u16, steps: &[Step]) -> Vec<ProcessData> {
    let entry = |object: &MappedObject| Mapped {
        at: Address::new(object.index, object.sub),
        bits: object.bits,
        quantity: object.quantity,
        value: script::constant(object, steps),
    };
    let pdo = |pdo: &MappedPdo| ProcessData {
        device,
        index: first + pdo.number.saturating_sub(1),
        is_fixed: pdo.is_fixed,
        entries: pdo.objects.iter().map(entry).collect(),
    };
    pdos.iter().map(pdo).collect()
}

/// A force sensor on a segment.
#[derive(Clone, Debug)]
pub struct SegmentSensor {
    /// Name for messages.
    pub name: String,
    /// Position on the segment, 0 at the master.
    pub position: u16,
    /// Device model.
    pub profile: Arc<DeviceProfile>,
    /// How long it is waited for.
    pub waits: Waits,
    /// Steps of the boot besides its process data.
    pub start: SensorStart,
}

impl SegmentSensor {
    /// The sensor as a device of a segment, which samples by its own clock.
    ///
    /// # Errors
    /// If the profile is not one of a force sensor.
    pub fn station(&self) -> Result<StationSetup, BootFailure> {
        let profile = &*self.profile;
        let steps = script::sensor(profile, &self.start)?;
        let [outputs, inputs] = script::pdos(profile, None)?;
        // The object by which it zeroes itself is 0 in process data.
        let device = Device::Sensor;
        let process_data = [process_data(device, &outputs, 0x1600, &[]), process_data(device, &inputs, 0x1a00, &[])];
        let identity = profile.identity.clone();
        let station = StationSetup::other(&self.name, device, self.position, identity, self.waits, process_data);
        Ok(StationSetup { codec: SampleCodec::new(profile), steps, ..station })
    }
}

impl StationSetup {
    /// A device that is none of the drives: it has to be what it is said to be, and nothing is written but its process data.
    pub fn other(
        name: &str,
        device: Device,
        position: u16,
        identity: Identity,
        waits: Waits,
        process_data: [Vec<ProcessData>; 2],
    ) -> Self {
        let [outputs, inputs] = process_data;
        StationSetup {
            name: name.to_owned(),
            devices: device.set(),
            position,
            alias: None,
            serial: None,
            identity,
            waits,
            acts: Acts::ByItself,
            sync1: None,
            outputs,
            inputs,
            set_point: None,
            axes: Default::default(),
            codec: SampleCodec::default(),
            steps: Vec::new(),
        }
    }

    /// All objects that the boot reads and writes of it.
    pub fn plan(&self) -> ScriptPlan {
        ScriptPlan::new(&self.script(), &self.identity)
    }

    /// Adds another axis, whose process data follow the existing ones. Values that both axes write to objects of the device are
    /// written once.
    #[must_use]
    pub fn with_axis(mut self, axis: Self) -> Self {
        self.name = format!("{} and {}", self.name, axis.name);
        for ((own, new), device) in self.axes.iter_mut().zip(axis.axes).zip(Device::DRIVES) {
            if axis.devices.contains(device.set()) {
                *own = new;
            }
        }
        self.devices |= axis.devices;
        self.outputs.extend(axis.outputs);
        self.inputs.extend(axis.inputs);
        script::add_axis(&mut self.steps, axis.steps);
        self
    }

    /// Bytes of process data that the master sends.
    pub fn output_bytes(&self) -> usize {
        bytes(&self.outputs)
    }

    /// Bytes of process data that it sends.
    pub fn input_bytes(&self) -> usize {
        bytes(&self.inputs)
    }

    /// All objects that are read and written, in their order: those of the device, its process data, its synchronisation in PRE-OP, its mode in
    /// force in SAFE-OP.
    pub(super) fn script(&self) -> Vec<Step> {
        let mut steps = self.steps.clone();
        map(0x1c12, &self.outputs, &mut steps);
        map(0x1c13, &self.inputs, &mut steps);
        let types = self.acts.sync_types();
        let step = |doing, index, action| Step { doing, index, sub: 1, bytes: 2, action };
        let both = [0x1c32, 0x1c33].into_iter().zip(types.into_iter().flatten());
        steps.extend(both.map(|(index, value)| step("set the synchronisation", index, Action::SyncType { value })));
        if let Some([value, _]) = types {
            steps.push(step("check the synchronisation in force", 0x1c32, Action::Synchronised { value }));
        }
        if self.acts == Acts::AtSync0 {
            let doing = "read the time to copy outputs";
            steps.push(Step { doing, index: 0x1c32, sub: 6, bytes: 4, action: Action::CopyTime });
        }
        // Last, since they are looked at in SAFE-OP.
        steps.sort_by_key(|step| step.action.is_late());
        steps
    }
}

/// Bytes of process data.
fn bytes(pdos: &[ProcessData]) -> usize {
    pdos.iter().flat_map(|pdo| &pdo.entries).map(|entry| usize::from(entry.bits)).sum::<usize>().div_ceil(8)
}

/// The mapping objects and the object that says which are exchanged, as a unit: switched off, written, switched on. Each mapping is a unit of
/// its own, so that a fixed one stays while others are chosen.
fn map(assignment: u16, pdos: &[ProcessData], steps: &mut Vec<Step>) {
    if pdos.is_empty() {
        return;
    }
    let access =
        |index: u16, sub: u8, bytes: u8, action| Step { doing: "map the process data", index, sub, bytes, action };
    let state = |value| Action::State { value, kept: 0 };
    let mut all = vec![access(assignment, 0, 1, Action::Off { value: 0, kept: 0 })];
    for pdo in pdos {
        let raw = |entry: &Mapped| MappingEntry::new(entry.at.index, entry.at.sub, entry.bits).to_u32();
        let entries: Vec<u32> = pdo.entries.iter().map(raw).collect();
        all.extend(script::mapping_steps(pdo.index, pdo.is_fixed, &entries));
    }
    all.extend((1..=MOST_ENTRIES).zip(pdos).map(|(sub, pdo)| access(assignment, sub, 2, state(pdo.index.into()))));
    all.push(access(assignment, 0, 1, state(pdos.len() as u32)));
    steps.extend(unit(all));
}
