//! The objects of CiA 301, CiA 402 and CiA 404 that this project reads, writes or serves.
//!
//! `bits` of a mapping entry and the length of an SDO transfer both follow from [`Object::data_type`], so that a type is
//! written down once.

/// Data type of an object (CiA 301, 7.4.7 names them `INTEGER8` to `VISIBLE_STRING`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DataType {
    /// `INTEGER8`.
    I8,
    /// `INTEGER16`.
    I16,
    /// `INTEGER32`.
    I32,
    /// `UNSIGNED8`.
    U8,
    /// `UNSIGNED16`.
    U16,
    /// `UNSIGNED32`.
    U32,
    /// `VISIBLE_STRING`, which no PDO carries.
    Text,
}

impl DataType {
    /// Length in bits; 0 for text, whose length is not fixed.
    pub const fn bits(self) -> u8 {
        match self {
            DataType::I8 | DataType::U8 => 8,
            DataType::I16 | DataType::U16 => 16,
            DataType::I32 | DataType::U32 => 32,
            DataType::Text => 0,
        }
    }

    /// The number under which CiA 301 describes the type, as data sheets write it.
    pub const fn number(self) -> u16 {
        match self {
            DataType::I8 => 0x02,
            DataType::I16 => 0x03,
            DataType::I32 => 0x04,
            DataType::U8 => 0x05,
            DataType::U16 => 0x06,
            DataType::U32 => 0x07,
            DataType::Text => 0x09,
        }
    }
}

/// An object or sub-object: its place, type and meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Object {
    /// Index in the object dictionary.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Data type.
    pub data_type: DataType,
    /// Its name here, in capitals.
    pub name: &'static str,
    /// Meaning and unit, with the standard that defines it.
    pub meaning: &'static str,
}

impl Object {
    /// The sibling at sub-index `sub`, for arrays whose elements share a type.
    pub const fn at(self, sub: u8) -> Object {
        Object { sub, ..self }
    }

    /// Length in bits; 0 for text.
    pub const fn bits(self) -> u8 {
        self.data_type.bits()
    }
}

macro_rules! objects {
    ($($name:ident = $index:literal : $sub:literal, $data_type:ident, $meaning:literal;)*) => {
        $(
            #[doc = concat!("`", stringify!($index), ":", stringify!($sub), "` ", stringify!($data_type), ": ", $meaning, ".")]
            pub const $name: Object =
                Object { index: $index, sub: $sub, data_type: DataType::$data_type, name: stringify!($name), meaning: $meaning };
        )*
        /// Every object of this module, ascending by index and sub-index.
        pub const ALL: &[Object] = &[$($name),*];
    };
}

objects! {
    DEVICE_TYPE = 0x1000:0, U32, "device profile number in the low word (CiA 301)";
    ERROR_REGISTER = 0x1001:0, U8, "error register, bit 0 generic, bit 4 communication (CiA 301)";
    ERROR_HISTORY = 0x1003:0, U8, "number of stored errors, 0 clears them (CiA 301)";
    SYNC_COB_ID = 0x1005:0, U32, "COB-ID of SYNC (CiA 301)";
    SYNC_CYCLE = 0x1006:0, U32, "communication cycle period in us (CiA 301)";
    SYNC_WINDOW = 0x1007:0, U32, "synchronous window length in us (CiA 301)";
    DEVICE_NAME = 0x1008:0, Text, "manufacturer device name (CiA 301)";
    GUARD_TIME = 0x100c:0, U16, "node guarding: guard time in ms (CiA 301)";
    LIFE_TIME_FACTOR = 0x100d:0, U8, "node guarding: guard times without request until the master is lost (CiA 301)";
    STORE_PARAMETERS = 0x1010:1, U32, "writing 'save' stores all parameters (CiA 301)";
    RESTORE_PARAMETERS = 0x1011:1, U32, "writing 'load' restores all parameters as delivered with the next reset (CiA 301)";
    TIME_COB_ID = 0x1012:0, U32, "COB-ID of TIME, bit 31 for a consumer (CiA 301)";
    EMERGENCY_COB_ID = 0x1014:0, U32, "COB-ID of EMCY (CiA 301)";
    EMERGENCY_INHIBIT = 0x1015:0, U16, "inhibit time of EMCY in 100 us (CiA 301)";
    CONSUMER_HEARTBEAT = 0x1016:1, U32, "watched node id in bits 16 to 22, time in ms in the low word (CiA 301)";
    PRODUCER_HEARTBEAT = 0x1017:0, U16, "heartbeat period in ms, 0 switches it off (CiA 301)";
    VENDOR_ID = 0x1018:1, U32, "identity: vendor (CiA 301)";
    PRODUCT_CODE = 0x1018:2, U32, "identity: product (CiA 301)";
    REVISION = 0x1018:3, U32, "identity: revision (CiA 301)";
    SERIAL_NUMBER = 0x1018:4, U32, "identity: serial number (CiA 301)";
    SYNC_COUNTER_OVERFLOW = 0x1019:0, U8, "overflow of the SYNC counter, 0 or 2 to 240 (CiA 301)";
    ERROR_BEHAVIOUR = 0x1029:1, U8, "on communication error: 0 pre-operational, 1 no change, 2 stopped (CiA 301)";
    SENSOR_STATUS = 0x2001:0, U8, "status of the newest sample: bit 0 overload (simulated force sensor)";
    SENSOR_SAMPLE_COUNTER = 0x2002:0, U8, "rises by one with each new sample, wraps (simulated force sensor)";
    SIMULATION_LACKS = 0x2010:0, U8, "watchdogs that the drive lacks: bit 0 SYNC, 1 set-points, 2 heartbeat (simulated servo)";
    SIMULATION_CLOCK = 0x2011:0, U8, "what its time follows: 0 another process, 1 SYNC, 2 the wall (simulated servo)";
    SIMULATION_MARK = 0x2012:1, U32, "first of four words that hold the text `simulated device` (every simulated device)";
    ABORT_CONNECTION_OPTION = 0x6007:0, I16, "on loss of communication: 0 nothing, 1 fault, 2 disable voltage, 3 quick stop (CiA 402)";
    ERROR_CODE = 0x603f:0, U16, "last error code (CiA 402)";
    CONTROLWORD = 0x6040:0, U16, "controlword (CiA 402)";
    STATUSWORD = 0x6041:0, U16, "statusword (CiA 402)";
    QUICK_STOP_OPTION = 0x605a:0, I16, "quick stop option code, 0 to 8 (CiA 402)";
    SHUTDOWN_OPTION = 0x605b:0, I16, "shutdown option code, 0 or 1 (CiA 402)";
    DISABLE_OPERATION_OPTION = 0x605c:0, I16, "disable operation option code, 0 or 1 (CiA 402)";
    HALT_OPTION = 0x605d:0, I16, "halt option code, 1 to 4 (CiA 402)";
    FAULT_REACTION_OPTION = 0x605e:0, I16, "fault reaction option code, 0 to 4 (CiA 402)";
    MODE_OF_OPERATION = 0x6060:0, I8, "requested mode of operation (CiA 402)";
    MODE_DISPLAY = 0x6061:0, I8, "mode of operation in force (CiA 402)";
    POSITION_ACTUAL = 0x6064:0, I32, "position in counts (CiA 402)";
    FOLLOWING_ERROR_WINDOW = 0x6065:0, U32, "allowed following error in counts, FFFFFFFFh switches it off (CiA 402)";
    FOLLOWING_ERROR_TIMEOUT = 0x6066:0, U16, "time in ms outside the window until the fault (CiA 402)";
    VELOCITY_ACTUAL = 0x606c:0, I32, "velocity in counts/s (CiA 402)";
    TARGET_TORQUE = 0x6071:0, I16, "target torque in per mille of rated torque (CiA 402)";
    MAX_TORQUE = 0x6072:0, U16, "torque limit in per mille of rated torque (CiA 402)";
    RATED_TORQUE = 0x6076:0, U32, "motor rated torque in mN m (CiA 402)";
    TORQUE_ACTUAL = 0x6077:0, I16, "torque in per mille of rated torque (CiA 402)";
    TARGET_POSITION = 0x607a:0, I32, "target position in counts (CiA 402)";
    HOME_OFFSET = 0x607c:0, I32, "home offset in counts: what the position is at home, or its negative, by the drive (CiA 402)";
    MAX_MOTOR_SPEED = 0x6080:0, U32, "speed limit in r/min of the motor, before a gear (CiA 402)";
    PROFILE_DECELERATION = 0x6084:0, U32, "slow-down ramp in counts/s^2 (CiA 402)";
    QUICK_STOP_DECELERATION = 0x6085:0, U32, "quick stop ramp in counts/s^2 (CiA 402)";
    ENCODER_INCREMENTS = 0x608f:1, U32, "encoder resolution: increments (CiA 402)";
    ENCODER_REVOLUTIONS = 0x608f:2, U32, "encoder resolution: per that many revolutions (CiA 402)";
    HOMING_METHOD = 0x6098:0, I8, "homing method, 37 for the present position (CiA 402)";
    HOMING_SWITCH_SPEED = 0x6099:1, U32, "homing: speed during the search for a switch, counts/s (CiA 402)";
    HOMING_ZERO_SPEED = 0x6099:2, U32, "homing: speed during the search for zero, counts/s (CiA 402)";
    HOMING_ACCELERATION = 0x609a:0, U32, "homing: acceleration in counts/s^2 (CiA 402)";
    POSITION_OFFSET = 0x60b0:0, I32, "added to the target position, counts (CiA 402)";
    VELOCITY_OFFSET = 0x60b1:0, I32, "velocity feed-forward, counts/s (CiA 402)";
    TORQUE_OFFSET = 0x60b2:0, I16, "torque feed-forward, per mille of rated torque (CiA 402)";
    INTERPOLATION_TIME = 0x60c2:1, U8, "interpolation time period: value (CiA 402)";
    INTERPOLATION_EXPONENT = 0x60c2:2, I8, "interpolation time period: power of ten of a second, -3 for ms (CiA 402)";
    POSITIVE_TORQUE_LIMIT = 0x60e0:0, U16, "torque limit in positive direction, per mille (CiA 402)";
    NEGATIVE_TORQUE_LIMIT = 0x60e1:0, U16, "torque limit in negative direction, per mille (CiA 402)";
    FOLLOWING_ERROR_ACTUAL = 0x60f4:0, I32, "following error in counts (CiA 402)";
    DIGITAL_OUTPUTS = 0x60fe:1, U32, "digital outputs, bit 0 closes the brake (CiA 402)";
    DIGITAL_OUTPUT_MASK = 0x60fe:2, U32, "which digital outputs 60FEh:1 sets (CiA 402)";
    TARGET_VELOCITY = 0x60ff:0, I32, "target velocity in counts/s (CiA 402)";
    AUTO_ZERO = 0x6125:1, U32, "writing 'zero' makes the present reading of the channel the zero (CiA 404)";
    SUPPORTED_MODES = 0x6502:0, U32, "supported drive modes, bit n-1 for mode n (CiA 402)";
    PROCESS_VALUE = 0x7130:1, I16, "process value of the channel, 16 bits (CiA 404)";
}

/// Value to write to [`AUTO_ZERO`]: the text `zero`, first letter in the lowest byte.
///
/// # Source
/// CiA 404, object 6125h.
pub const AUTO_ZERO_SIGNATURE: u32 = u32::from_le_bytes(*b"zero");

/// Value to write to [`STORE_PARAMETERS`]: the text `save`, first letter in the lowest byte.
///
/// # Source
/// CiA 301, object 1010h.
pub const STORE_SIGNATURE: u32 = u32::from_le_bytes(*b"save");

/// The index of an object of CiA 402 of any axis as that of a first axis; of other objects their own.
///
/// # Source
/// CiA 402-2: objects of axes lie 800h apart, from 6000h to 9FFFh.
pub const fn of_first_axis(index: u16) -> u16 {
    if index >= 0x6000 && index < 0xa000 { 0x6000 | index & 0x07ff } else { index }
}

/// Content of [`SIMULATION_MARK`] and the three sub-indices after it: the text `simulated device`, first letter in the lowest
/// byte.
pub const SIMULATED_DEVICE: [u32; 4] = [
    u32::from_le_bytes(*b"simu"),
    u32::from_le_bytes(*b"late"),
    u32::from_le_bytes(*b"d de"),
    u32::from_le_bytes(*b"vice"),
];

/// Emergency error codes (CiA 301 and CiA 402) that the devices of this project raise.
pub mod error_code {
    /// No error, or the last one was reset.
    pub const NONE: u16 = 0x0000;
    /// The heartbeat of a watched node stayed away.
    pub const HEARTBEAT: u16 = 0x8130;
    /// An RPDO came with the wrong length.
    pub const PDO_LENGTH: u16 = 0x8210;
    /// A SYNC came with another length than the counter asks for.
    pub const SYNC_LENGTH: u16 = 0x8240;
    /// An RPDO did not come in its deadline.
    pub const RPDO_TIMEOUT: u16 = 0x8250;
    /// The power stage has too little voltage.
    pub const UNDER_VOLTAGE: u16 = 0x3220;
    /// The position sensor gives no usable value.
    pub const ENCODER: u16 = 0x7305;
    /// SYNC stayed away in a cyclic synchronous mode.
    pub const SYNC_LOST: u16 = 0x8700;
    /// The following error stayed outside its window.
    pub const FOLLOWING_ERROR: u16 = 0x8611;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_sorted_and_free_of_doubles() {
        for pair in ALL.windows(2) {
            assert!((pair[0].index, pair[0].sub) < (pair[1].index, pair[1].sub), "{:x?}", pair);
        }
    }

    #[test]
    fn signatures_are_the_literals_of_the_standards() {
        assert_eq!(AUTO_ZERO_SIGNATURE, 0x6f72_657a);
        assert_eq!(STORE_SIGNATURE, 0x6576_6173);
    }

    #[test]
    fn the_mark_of_a_simulated_device_is_text_of_four_words() {
        let text: Vec<u8> = SIMULATED_DEVICE.into_iter().flat_map(u32::to_le_bytes).collect();
        assert_eq!(text, b"simulated device");
    }
}
