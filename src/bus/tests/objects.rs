//! Objects of the devices, asked for beside the cycle.

use super::*;
use yieldwall_fieldbus::objects::{AbortCode, Address, ObjectAnswer, ObjectError, ObjectRequest};
use yieldwall_motion::guard::Device;

const STATUSWORD: ObjectRequest<'_> = ObjectRequest::Read(Address::new(0x6041, 0));

impl Net {
    fn ask(&mut self, device: Device, request: ObjectRequest<'_>) -> Result<(), ObjectError> {
        self.master.networks_mut().ask(self.now, device, request, &mut self.sent)
    }
}

#[test]
fn an_object_is_read_and_written_beside_the_cycle() {
    let mut net = Net::running(CommandMode::Torque);
    assert_eq!(net.master.networks().answer(Device::LeftDrive), ObjectAnswer::NotAsked);
    net.ask(Device::LeftDrive, STATUSWORD).unwrap();
    assert_eq!(net.take(), ["601#4041600000000000"]);
    assert_eq!(net.ask(Device::LeftDrive, STATUSWORD), Err(ObjectError::Busy));
    // Another node's answer is none, and the cycle goes on.
    net.hear("582#4B41600037020000");
    net.quiet("3712", Request::None);
    assert_eq!(net.master.networks().answer(Device::LeftDrive), ObjectAnswer::Pending);
    net.hear("581#4B41600037020000");
    assert_eq!(net.master.networks().answer(Device::LeftDrive), ObjectAnswer::Done(&[0x37, 0x02]));
    net.quiet("3712", Request::None);
    assert_eq!(net.state(), (State::Running, None));
    net.take();

    let write = ObjectRequest::Write(Address::new(0x1016, 1), &[0; 4]);
    net.ask(Device::RightDrive, write).unwrap();
    assert_eq!(net.take(), ["602#2316100100000000"]);
    net.hear("582#6016100100000000");
    assert_eq!(net.master.networks().answer(Device::RightDrive), ObjectAnswer::Done(&[]));
    net.ask(Device::RightDrive, write).unwrap();
    net.hear("582#8016100111000906");
    let refused = ObjectError::Aborted(AbortCode(0x0609_0011));
    assert_eq!(net.master.networks().answer(Device::RightDrive), ObjectAnswer::Failed(refused));
    let long = ObjectRequest::Write(Address::new(0x1010, 1), &[0; 1025]);
    assert_eq!(net.ask(Device::RightDrive, long), Err(ObjectError::TooLong(1025)));
}

#[test]
fn a_device_that_does_not_answer_is_given_up_after_its_time() {
    let mut net = Net::running(CommandMode::Torque);
    net.ask(Device::Sensor, STATUSWORD).unwrap();
    let asked = net.now;
    while net.master.networks().answer(Device::Sensor) == ObjectAnswer::Pending {
        let next = net.master.networks().next_deadline();
        assert!(next > net.now && next.since(asked) <= WAITS.sdo * 3, "{next:?}");
        for line in ["701#05", "702#05", "70A#05"] {
            net.hear(line);
        }
        net.now = next.min(net.now + Duration::from_millis(10));
        net.master.networks_mut().poll(net.now, &mut net.sent);
    }
    assert_eq!(net.master.networks().answer(Device::Sensor), ObjectAnswer::Failed(ObjectError::NoAnswer));
    assert!(net.now.since(asked) >= WAITS.sdo);
}

#[test]
fn a_network_that_is_started_anew_answers_nothing_of_before_and_is_not_asked_while_it_is_configured() {
    let mut net = Net::running(CommandMode::Torque);
    net.ask(Device::LeftDrive, STATUSWORD).unwrap();
    net.master.start(net.now, &mut net.sent);
    assert_eq!(net.master.networks().answer(Device::LeftDrive), ObjectAnswer::Failed(ObjectError::NoAnswer));
    for line in ["701#00", "702#00", "70A#00"] {
        net.hear(line);
    }
    assert_eq!(*net.master.networks().phase(), Phase::Configuring);
    assert_eq!(net.ask(Device::LeftDrive, STATUSWORD), Err(ObjectError::Busy));
}

#[test]
fn nothing_is_asked_where_nothing_may_be_sent() {
    let mut net = Net::new(CommandMode::Torque);
    assert_eq!(net.ask(Device::LeftDrive, STATUSWORD), Err(ObjectError::NotBooted));
    assert!(net.take().is_empty());
    // Another master, while an object is asked for.
    let mut net = Net::running(CommandMode::Torque);
    net.master.networks_mut().leave(&mut net.sent);
    net.ask(Device::LeftDrive, STATUSWORD).unwrap();
    net.take();
    net.hear("000#0101");
    assert!(matches!(net.master.networks().phase(), Phase::Failed(_)));
    assert_eq!(net.master.networks().answer(Device::LeftDrive), ObjectAnswer::Failed(ObjectError::NoAnswer));
    assert_eq!(net.ask(Device::LeftDrive, STATUSWORD), Err(ObjectError::NotBooted));
    net.wait(WAITS.sdo * 10);
    assert!(net.take().is_empty());
}
