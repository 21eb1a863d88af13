//! Meaning of the error codes of CiA 301 and CiA 402.

/// Texts for a code.
pub(super) struct Texts {
    pub(super) name: &'static str,
    pub(super) meaning: &'static str,
    pub(super) cause: &'static str,
    pub(super) next: &'static str,
}

const OF_MAKER: &str = "the maker of the device gives it its own meaning";
const LOOK_UP: &str = "look it up in the device's manual; `yieldwall emcy NODE` shows what else the device has stored";
const SUPPLY: &str =
    "measure the supply at the drive under load; `yieldwall info NODE` shows what the drive reports of itself";
const SHORT: &str =
    "switch off; measure the motor's windings and cable against each other and against earth before power comes back";
const COOL: &str = "let it cool down; look at its mounting and fan, and lower torque_limit_n_m if it comes back";
const FEEDBACK: &str = "look at the encoder's plug, cable and shield; turn the shaft by hand and read `yieldwall od read NODE position-actual`";
const DEFECT: &str = "switch the device off and on; if it comes back the device goes to its maker";
const PARAMETERS: &str =
    "compare the drive's settings with the ones it was commissioned with: `yieldwall od diff NODE FILE`";
const CHECK_BUS: &str = "check cable, termination and bit rate; `yieldwall monitor` shows what is on the bus";
const LOOP: &str = "free the arm; look at the drive's own tuning and limits: `yieldwall info NODE`";

macro_rules! codes {
    ($($code:literal $name:literal, $meaning:literal, $cause:literal, $next:expr;)*) => {
        /// The codes that have a meaning of their own, ascending.
        pub(super) const LISTED: &[u16] = &[$($code),*];

        /// Returns the texts for a code; a code that is not listed has the texts of its class.
        pub(super) const fn texts(code: u16) -> Texts {
            match code {
                $($code => Texts { name: $name, meaning: $meaning, cause: $cause, next: $next },)*
                _ => of_class(code),
            }
        }
    };
}

codes! {
    0x0000 "no-error", "no error, or one error fewer", "what was wrong has gone", "nothing: the device has recovered";
    0x1000 "generic", "generic error", "something that no other code of the device says", LOOK_UP;
    0x2310 "over-current", "continuous over-current", "the motor is blocked or overloaded, or the drive's current loop is badly tuned", LOOP;
    0x2320 "short-circuit-or-earth", "short circuit or earth leakage", "a damaged motor cable, or a motor with a damaged winding", SHORT;
    0x2330 "earth-leakage", "earth leakage", "a damaged motor cable, or a motor with a damaged winding", SHORT;
    0x2340 "short-circuit", "short circuit", "two phases of the motor or its cable touch, or the power stage is defective", SHORT;
    0x2350 "load-level", "load level fault (I2t)", "the motor gave more than its rated torque for too long", COOL;
    0x3110 "mains-over-voltage", "mains over-voltage", "the supply is above what the drive bears", SUPPLY;
    0x3120 "mains-under-voltage", "mains under-voltage", "the supply is too weak or its cable too thin", SUPPLY;
    0x3130 "phase-failure", "phase failure", "a phase of the supply is missing", SUPPLY;
    0x3210 "dc-link-over-voltage", "DC link over-voltage", "the arm was braked and nothing takes the power that comes back", "lower stop_deceleration_m_per_s2, or give the drive a brake resistor";
    0x3220 "dc-link-under-voltage", "DC link under-voltage", "the supply of the power stage is off, too weak, or cut by an emergency stop", SUPPLY;
    0x3310 "output-over-voltage", "output over-voltage", "the power stage drives more voltage than it may", LOOK_UP;
    0x4110 "ambient-hot", "ambient temperature too high", "the cabinet is not cooled enough", COOL;
    0x4210 "device-hot", "device temperature too high", "the device is overloaded, or its cooling is poor", COOL;
    0x4310 "drive-hot", "drive temperature too high", "the drive is overloaded, or its cooling is poor", COOL;
    0x5112 "logic-under-voltage", "logic supply under-voltage", "the 24 V supply dips, often when a brake or a fan switches on", SUPPLY;
    0x5113 "logic-under-voltage-5v", "logic supply under-voltage, 5 V", "an encoder or an input draws more than the drive's 5 V give", "unplug encoder and inputs one by one, then measure the 5 V";
    0x5441 "contact-1", "a contact of the device acted: which one, its maker says", "emergency stop, safe torque off or an enable input", "close the contact, then `yieldwall state NODE` says whether the drive is ready";
    0x5530 "data-memory", "non-volatile data memory", "the device could not read or keep its stored settings", PARAMETERS;
    0x6010 "software-watchdog", "software watchdog", "the device's own program hung and was started again", DEFECT;
    0x6320 "parameter", "parameter error", "a setting is out of range, or two settings contradict each other", PARAMETERS;
    0x7110 "brake-chopper", "brake chopper", "the brake resistor is missing, broken or overloaded", "measure the brake resistor; brake more gently with a lower stop_deceleration_m_per_s2";
    0x7121 "motor-blocked", "motor blocked", "the arm stands against something, a brake is closed, or phases and encoder do not match", "free the arm and look at the brake; then check order of phases and commutation";
    0x7122 "commutation", "motor error or commutation fault", "phases, hall sensors and encoder do not match", "check order of phases and encoder direction, then commission the motor anew with its maker's program";
    0x7300 "sensor", "position or speed sensor", "the encoder is unplugged, has no supply or is disturbed", FEEDBACK;
    0x7305 "incremental-encoder-1", "incremental encoder 1", "a signal of the encoder is missing or disturbed", FEEDBACK;
    0x7306 "incremental-encoder-2", "incremental encoder 2", "a signal of the encoder is missing or disturbed", FEEDBACK;
    0x7310 "speed-limit", "speed above its limit", "the limit of the drive is below that of the rig, or the motor ran away", "compare `yieldwall info NODE` with the rig's speed limits; check the encoder's direction";
    0x7320 "position-limit", "position", "the position sensor is wrong, or the drive's position range is left", FEEDBACK;
    0x7500 "internal-communication", "communication inside the device", "a part of the device does not answer another one", DEFECT;
    0x8110 "can-overrun", "CAN overrun, frames lost", "frames came faster than the device takes them", "`yieldwall bus budget RIG.yaml` shows the load; lengthen period_us or leave out devices";
    0x8120 "can-error-passive", "CAN error passive", "many frames were damaged: cable, termination or bit rate", CHECK_BUS;
    0x8130 "heartbeat-lost", "heartbeat or life guarding lost", "the master went away, or its heartbeat came later than the device waits", "look why the master fell silent; compare heartbeat_ms with `yieldwall od read NODE 1016h:1`";
    0x8140 "bus-off-recovered", "recovered from bus-off", "the device left the bus for many damaged frames and came back", CHECK_BUS;
    0x8150 "can-id-collision", "CAN-ID collision", "two devices send with one identifier", "`yieldwall scan` shows who is there; give each device its own node id";
    0x8210 "pdo-short", "PDO too short, not processed", "the mapping in the device and the frames of the master differ", "start the run again, which writes the mapping; `yieldwall pdo show NODE` shows it";
    0x8220 "pdo-long", "PDO longer than mapped", "the mapping in the device and the frames of the master differ", "start the run again, which writes the mapping; `yieldwall pdo show NODE` shows it";
    0x8240 "sync-length", "unexpected SYNC length", "the counter of SYNC (1019h) is on at one side alone", "`yieldwall od read NODE 1019h` is 0 for a SYNC without counter";
    0x8250 "rpdo-timeout", "RPDO did not come in time", "the master was late or fell silent, or the event timer of the RPDO is too short", "look at the cycle's lateness with `yieldwall latency`, then start the run again";
    0x8311 "excess-torque", "excess torque", "the load is too heavy, or the drive's current loop is badly tuned", LOOP;
    0x8400 "speed-control", "speed control", "the drive does not keep its speed: blocked, too weak or badly tuned", LOOP;
    0x8500 "position-control", "position control", "the drive does not keep its position: blocked, too weak or badly tuned", LOOP;
    0x8600 "positioning", "positioning", "the drive cannot reach its target", LOOP;
    0x8611 "following-error", "following error above its window", "the arm is blocked, or gains or torque limit of the drive are too low", "free the arm; compare following-error-window and limits in `yieldwall info NODE` with the rig";
    0x8612 "reference-limit", "reference limit reached", "the target lies beyond the drive's position limits", "compare the drive's limits with the rig: `yieldwall od read NODE 607Dh:1 607Dh:2`";
}

const fn class(name: &'static str, meaning: &'static str) -> Texts {
    Texts { name, meaning, cause: OF_MAKER, next: LOOK_UP }
}

const fn of_class(code: u16) -> Texts {
    match code {
        0x0001..=0x00ff => class("no-error", "no error, or one error fewer"),
        0x1000..=0x10ff => class("generic", "generic error"),
        0x2000..=0x20ff => class("current", "current"),
        0x2100..=0x21ff => class("input-current", "current, input side"),
        0x2200..=0x22ff => class("internal-current", "current inside the device"),
        0x2300..=0x23ff => class("output-current", "current, output side"),
        0x2400..=0x2fff => class("current", "current"),
        0x3000..=0x30ff => class("voltage", "voltage"),
        0x3100..=0x31ff => class("mains-voltage", "mains voltage"),
        0x3200..=0x32ff => class("internal-voltage", "voltage inside the device"),
        0x3300..=0x33ff => class("output-voltage", "output voltage"),
        0x3400..=0x3fff => class("voltage", "voltage"),
        0x4000..=0x40ff => class("temperature", "temperature"),
        0x4100..=0x41ff => class("ambient-temperature", "ambient temperature"),
        0x4200..=0x42ff => class("device-temperature", "device temperature"),
        0x4300..=0x4fff => class("temperature", "temperature"),
        0x5000..=0x5fff => class("hardware", "device hardware"),
        0x6000..=0x60ff => class("software", "device software"),
        0x6100..=0x61ff => class("internal-software", "internal software"),
        0x6200..=0x62ff => class("user-software", "user software"),
        0x6300..=0x63ff => class("data-set", "data set"),
        0x6400..=0x6fff => class("software", "device software"),
        0x7000..=0x7fff => class("additional-modules", "additional modules"),
        0x8000..=0x80ff => class("monitoring", "monitoring"),
        0x8100..=0x81ff => class("communication", "communication"),
        0x8200..=0x82ff => class("protocol", "protocol error"),
        0x8300..=0x8fff => class("monitoring", "monitoring"),
        0x9000..=0x90ff => class("external", "external error"),
        0xf000..=0xf0ff => class("additional-functions", "additional functions"),
        0xff00..=0xffff => class("device-specific", "device specific"),
        _ => class("unknown", "code not defined by CiA 301"),
    }
}
