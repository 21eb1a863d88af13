//! The objects of a simulated force sensor, by its profile: what they show of a sample, and what takes the zero.

use yieldwall_drives::profiles::{Entry, ForceSensor, Numbers, Pdo, Quantity, Scaling, StatusBits, Unused};
use yieldwall_fieldbus::objects::{
    Access, Address, Builder, DataType, DictionaryError, Handle, Mappable, Object, ObjectDictionary,
};

use super::super::DeviceError;
use super::sampler::{CHANNELS, Conversion, Sampler};

const NAMES: [&str; CHANNELS] = ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"];
/// Names of what a sensor is sent, and of everything else.
const CONTROLS: [&str; 4] = ["Control 1", "Control 2", "Control 3", "Control 4"];
/// The first channels are forces.
const FORCES: usize = 3;

/// The objects that show a sample.
#[derive(Clone, Debug)]
pub(super) struct Shown {
    /// Each with its bits, 8 to 32.
    channels: [(Handle<u64>, u8); CHANNELS],
    numbers: Numbers,
    /// Counts per N and per N m, of numbers that are in N and N m.
    counts_per_unit: [f64; 2],
    status: Option<Handle<u64>>,
    overload: Option<Handle<u64>>,
    status_bits: StatusBits,
    counter: Option<Handle<u64>>,
    count: u32,
}

impl Shown {
    /// The objects of a profile in the dictionary that [`declare`] has put them into.
    ///
    /// # Errors
    /// If one is not there.
    pub(super) fn new(od: &ObjectDictionary, model: &ForceSensor) -> Result<Self, DictionaryError> {
        let objects = &model.objects;
        let mut channels = [(Handle::NOWHERE, 0); CHANNELS];
        for (entry, to) in objects.channels.iter().zip(&mut channels) {
            *to = (od.bits_handle(entry.index, entry.sub)?, entry.bits);
        }
        let handle = |entry: &Option<Entry>| entry.as_ref().map(|at| od.bits_handle(at.index, at.sub)).transpose();
        Ok(Self {
            channels,
            numbers: objects.numbers,
            counts_per_unit: match model.scaling {
                Some(Scaling::Constant { per_n, per_n_m }) => [per_n, per_n_m].map(f64::from),
                _ => [1.0; 2],
            },
            status: handle(&objects.status)?,
            overload: handle(&objects.overload)?,
            status_bits: model.status_bits,
            counter: handle(&objects.sample_counter)?,
            count: 0,
        })
    }

    /// As after power-on.
    pub(super) fn reset(&mut self) {
        self.count = 0;
    }

    /// Shows a sample. An invalid sample sets the first of the bits for it; if there is no such bit, the values are not numbers.
    pub(super) fn show(&mut self, od: &mut ObjectDictionary, conversion: &Conversion) {
        self.count = self.count.wrapping_add(1);
        let bits = self.status_bits;
        let is_nan = conversion.is_invalid && bits.invalid == 0;
        for (channel, (&(handle, width), &counts)) in self.channels.iter().zip(&conversion.counts).enumerate() {
            od.set(handle, self.word(channel, width, counts, is_nan));
        }
        let first = |is_set: bool, mask: u32| u64::from(if is_set { mask & mask.wrapping_neg() } else { 0 });
        let overload = first(conversion.is_overloaded, bits.overload);
        let invalid = first(conversion.is_invalid, bits.invalid);
        if let Some(status) = self.status {
            od.set(status, invalid | if self.overload.is_some() { 0 } else { overload });
        }
        if let Some(status) = self.overload {
            od.set(status, overload);
        }
        if let Some(counter) = self.counter {
            od.set(counter, self.count.into());
        }
    }

    /// The bits of a channel that reads so many counts; those beyond its range are cut off.
    fn word(&self, channel: usize, bits: u8, counts: i32, is_nan: bool) -> u64 {
        let half = 1i64 << (bits.clamp(1, 32) - 1);
        let kept = i64::from(counts).clamp(-half, half - 1);
        match self.numbers {
            Numbers::Signed => kept as u64,
            Numbers::Unsigned => (kept + half) as u64,
            Numbers::Real if is_nan => f32::NAN.to_bits().into(),
            Numbers::Real => {
                let [per_n, per_n_m] = self.counts_per_unit;
                let value = f64::from(counts) / if channel < FORCES { per_n } else { per_n_m };
                (value as f32).to_bits().into()
            }
        }
    }
}

/// Declares the objects of a profile that were not declared before, each record with its sub-index 0. Objects of `scaling` hold
/// `counts_per_unit`.
///
/// # Errors
/// If no type has the length of an object.
pub(super) fn declare(
    mut builder: Builder,
    model: &ForceSensor,
    counts_per_unit: [u32; 2],
) -> Result<Builder, DeviceError> {
    let objects = &model.objects;
    let shown = |object: Object, name| object.access(Access::ReadOnly).mappable(Mappable::Tpdo).named(name);
    let mut all: Vec<((u16, u8), Object)> = Vec::new();
    for (entry, name) in objects.channels.iter().zip(NAMES) {
        let object = match objects.numbers {
            Numbers::Real => Object::new(entry.index, entry.sub, 0f32),
            Numbers::Signed => Object::narrow(entry.index, entry.sub, signed(entry.bits)?, 0i64),
            Numbers::Unsigned => unsigned(entry.index, entry.sub, entry.bits, 0)?,
        };
        all.push(((entry.index, entry.sub), shown(object, name)));
    }
    for (entry, name) in
        [(&objects.status, "Status"), (&objects.overload, "Overload"), (&objects.sample_counter, "Sample counter")]
    {
        if let Some(entry) = entry {
            all.push(((entry.index, entry.sub), shown(unsigned(entry.index, entry.sub, entry.bits, 0)?, name)));
        }
    }
    let unused = |pdos: &[Pdo]| -> Vec<Unused> {
        let maps = pdos.iter().flat_map(|pdo| &pdo.maps);
        maps.filter_map(|quantity| if let Quantity::Unused(unused) = quantity { Some(*unused) } else { None }).collect()
    };
    for Unused { index, sub, bits, .. } in unused(&model.process_data.tpdo) {
        all.push(((index, sub), shown(unsigned(index, sub, bits, 0)?, "Unused")));
    }
    let controls = unused(&model.process_data.rpdo).into_iter();
    for (Unused { index, sub, bits, .. }, name) in controls.zip(CONTROLS.into_iter().cycle()) {
        all.push(((index, sub), unsigned(index, sub, bits, 0)?.mappable(Mappable::Rpdo).named(name)));
    }
    if let Some(Scaling::Objects { per_n, per_n_m }) = &model.scaling {
        for (entry, counts) in [per_n, per_n_m].into_iter().zip(counts_per_unit) {
            let object = unsigned(entry.index, entry.sub, entry.bits, counts)?.access(Access::ReadOnly);
            all.push(((entry.index, entry.sub), object.named("Counts per unit")));
        }
    }
    for Entry { index, sub, bits, .. } in model.zero.iter().map(|setting| &setting.object) {
        all.push(((*index, *sub), unsigned(*index, *sub, *bits, 0)?.named("Zero")));
    }
    let mut indices = Vec::new();
    for ((index, sub), object) in all {
        if !builder.has(index, sub) {
            builder = builder.object(object);
            indices.push(index);
        }
    }
    for index in indices {
        let subs = builder.subs(index);
        if !subs.contains(&0) {
            let name = if model.process_data.rpdo.is_empty() || index < 0x7000 { "Counts" } else { "Control" };
            let highest = subs.into_iter().max().unwrap_or_default();
            builder = builder.object(Object::highest_sub(index, highest).named(name));
        }
    }
    Ok(builder)
}

fn unsigned(index: u16, sub: u8, bits: u8, value: u32) -> Result<Object, DeviceError> {
    let data_type = match bits {
        1 => DataType::Boolean,
        8 => DataType::Unsigned8,
        16 => DataType::Unsigned16,
        24 => DataType::Unsigned24,
        32 => DataType::Unsigned32,
        40 => DataType::Unsigned40,
        48 => DataType::Unsigned48,
        56 => DataType::Unsigned56,
        64 => DataType::Unsigned64,
        bits => return Err(no_type(bits)),
    };
    Ok(Object::narrow(index, sub, data_type, u64::from(value)))
}

fn signed(bits: u8) -> Result<DataType, DeviceError> {
    Ok(match bits {
        8 => DataType::Integer8,
        16 => DataType::Integer16,
        24 => DataType::Integer24,
        32 => DataType::Integer32,
        bits => return Err(no_type(bits)),
    })
}

fn no_type(bits: u8) -> DeviceError {
    let range = "1, or 8, 16, 24 and so on up to 64, of an object in process data that is simulated";
    DeviceError::Setting { setting: "bits", value: bits.into(), range }
}

/// The objects by which a sensor takes its present reading for zero.
#[derive(Clone, Debug)]
pub(super) struct Zeroing {
    settings: Vec<Zero>,
}

#[derive(Clone, Copy, Debug)]
struct Zero {
    at: Address,
    value: u64,
    /// The one channel; all of them otherwise.
    channel: Option<usize>,
    /// Whether the object held the value before.
    was_held: bool,
}

impl Zeroing {
    /// Returns the shown objects of a profile, without objects of the index `except`.
    pub(super) fn new(model: &ForceSensor, except: u16) -> Self {
        let is_single = model.zero.len() == CHANNELS;
        let zero = |(channel, setting): (usize, &yieldwall_drives::profiles::Setting)| Zero {
            at: Address::new(setting.object.index, setting.object.sub),
            value: setting.raw().into(),
            channel: is_single.then_some(channel),
            was_held: false,
        };
        let settings = model.zero.iter().enumerate().map(zero).filter(|zero| zero.at.index != except);
        Self { settings: settings.collect() }
    }

    /// As after power-on.
    pub(super) fn reset(&mut self) {
        self.settings.iter_mut().for_each(|zero| zero.was_held = false);
    }

    /// Takes the zero if an object has come to its value, or was `written` with it.
    pub(super) fn look(&mut self, od: &ObjectDictionary, sampler: &mut Sampler, written: Option<Address>) {
        for zero in &mut self.settings {
            let held = od.raw(zero.at.index, zero.at.sub);
            let is_held = held & zero.value == zero.value && (zero.value != 0 || held == 0);
            if is_held && (!zero.was_held || written == Some(zero.at)) {
                match zero.channel {
                    Some(channel) => sampler.take_zero(channel),
                    None => (0..CHANNELS).for_each(|channel| sampler.take_zero(channel)),
                }
            }
            zero.was_held = is_held;
        }
    }
}
