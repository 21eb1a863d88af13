//! The fields of a record, in one list: schema, bytes, text and comparison all come from it.

use super::scalar::{CommandKind, Scalar};
use crate::{CycleRecord, DeviceRecord, Stages, Truth};
use yieldwall_motion::cycle::{DriveSample, Inputs, LinkEvents, Signals, Timing};
use yieldwall_motion::guard::{Cause, DeviceSet, Directive, Fault, JointCommand};
use yieldwall_motion::quantity::{JointAngles, JointRates, JointTorques};
use yieldwall_motion::sensing::RawSample;

/// Description of a field besides its value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// Name, unique; ends in the unit where there is one.
    pub name: &'static str,
    /// Unit; empty for a number without one.
    pub unit: &'static str,
    /// Meaning of the field.
    pub meaning: &'static str,
}

/// Goes over the fields in their order; may read a value, or put another in its place.
pub trait Visitor {
    fn visit<S: Scalar>(&mut self, field: Field, value: &mut S);

    /// Visits a field that another field may mark as absent; the value is then a zero without meaning.
    fn visit_if<S: Scalar>(&mut self, _is_there: bool, field: Field, value: &mut S) {
        self.visit(field, value);
    }
}

fn field(name: &'static str, unit: &'static str, meaning: &'static str) -> Field {
    Field { name, unit, meaning }
}

/// A value that may be missing, as a flag and a value, which is zero where the flag is not set.
fn optional<V: Visitor, S: Scalar + Default>(visitor: &mut V, flag: Field, value: Field, target: &mut Option<S>) {
    let mut is_there = target.is_some();
    let mut inner = target.unwrap_or_default();
    visitor.visit(flag, &mut is_there);
    visitor.visit_if(is_there, value, &mut inner);
    *target = is_there.then_some(inner);
}

/// Shows `visitor` every field of `record`.
pub(super) fn walk_cycle<V: Visitor>(record: &mut CycleRecord, v: &mut V) {
    let moment = &mut record.moment;
    v.visit(field("index", "", "number of the cycle since the boot, from 0"), &mut moment.index);
    v.visit(field("sync_ns", "ns", "planned moment of SYNC since switching on"), &mut moment.sync_ns);
    v.visit(field("compute_ns", "ns", "planned begin of the computation since switching on"), &mut moment.compute_ns);
    v.visit(
        field("scene_time_s", "s", "moment of SYNC since the scene began; minus infinity before"),
        &mut moment.scene_time_s,
    );
    stages(&mut record.moment.stages, v);
    inputs(record, v);
    outputs(record, v);
    truth(&mut record.truth, v);
}

/// Shows `visitor` every field of `record`.
pub(super) fn walk_sample<V: Visitor>(record: &mut DeviceRecord, v: &mut V) {
    let DeviceRecord {
        index,
        sample_ns,
        scene_time_s,
        reported_m: [reported_x, reported_y, reported_z],
        proxy_m: [proxy_x, proxy_y, proxy_z],
        force_n: [force_x, force_y, force_z],
        signed_distance_m,
        is_on_surface,
        hold_counter,
        is_impact,
        true_position_m: [true_x, true_y, true_z],
        true_velocity_m_per_s: [velocity_x, velocity_y, velocity_z],
    } = record;
    v.visit(field("index", "", "number of the sample, from 0"), index);
    v.visit(field("sample_ns", "ns", "moment of the sample since the scene began"), sample_ns);
    v.visit(field("scene_time_s", "s", "the same"), scene_time_s);
    v.visit(field("reported_x_m", "m", "position of the handle as the device reports it, base frame"), reported_x);
    v.visit(field("reported_y_m", "m", "the same, y"), reported_y);
    v.visit(field("reported_z_m", "m", "the same, z"), reported_z);
    v.visit(field("proxy_x_m", "m", "proxy, base frame"), proxy_x);
    v.visit(field("proxy_y_m", "m", "the same, y"), proxy_y);
    v.visit(field("proxy_z_m", "m", "the same, z"), proxy_z);
    v.visit(field("force_x_n", "N", "force of the actuators on the handle from this sample on, base frame"), force_x);
    v.visit(field("force_y_n", "N", "the same, y"), force_y);
    v.visit(field("force_z_n", "N", "the same, z"), force_z);
    v.visit(
        field("signed_distance_m", "m", "distance of the proxy from the surface, negative on the forbidden side"),
        signed_distance_m,
    );
    v.visit(field("is_on_surface", "", "the fixture keeps the proxy on the surface"), is_on_surface);
    v.visit(field("hold_counter", "samples", "samples for which the proxy is still held"), hold_counter);
    v.visit(field("is_impact", "", "the proxy met the surface at this sample"), is_impact);
    v.visit(field("true_x_m", "m", "position of the handle in the simulation, base frame"), true_x);
    v.visit(field("true_y_m", "m", "the same, y"), true_y);
    v.visit(field("true_z_m", "m", "the same, z"), true_z);
    v.visit(field("true_velocity_x_m_per_s", "m/s", "velocity of the handle in the simulation"), velocity_x);
    v.visit(field("true_velocity_y_m_per_s", "m/s", "the same, y"), velocity_y);
    v.visit(field("true_velocity_z_m_per_s", "m/s", "the same, z"), velocity_z);
}

fn stages<V: Visitor>(stages: &mut Stages, v: &mut V) {
    let Stages { sync_woke_ns, woke_ns, stepped_ns, sent_ns } = stages;
    v.visit(field("sync_woke_ns", "ns", "the loop woke up for SYNC, after the planned moment of SYNC"), sync_woke_ns);
    v.visit(field("woke_ns", "ns", "the loop woke up for the computation, after its planned begin"), woke_ns);
    v.visit(
        field("stepped_ns", "ns", "frames were decoded and the cycle was stepped, after the planned begin"),
        stepped_ns,
    );
    v.visit(field("sent_ns", "ns", "set-points were handed to the interface, after the planned begin"), sent_ns);
}

fn inputs<V: Visitor>(record: &mut CycleRecord, v: &mut V) {
    let Inputs { drives: [left, right], sample: force_sample, link, timing, request } = &mut record.inputs;
    drive(left, v, &LEFT);
    drive(right, v, &RIGHT);
    sample(force_sample, v);
    let LinkEvents {
        bad_length,
        duplicated,
        late,
        node_reset,
        heartbeat_lost,
        duplicate_node,
        emergency,
        emergency_warning,
        intruder,
        transmit_stalled,
        error_passive,
        bus_off,
        send_failed,
        outputs_missed,
        device_state,
        clock_lost,
        port_errors,
    } = link;
    v.visit(field("link_bad_length", "", "a process data frame had the wrong length"), bad_length);
    v.visit(field("link_duplicated", "", "a process data frame came twice"), duplicated);
    v.visit(field("link_late", "", "a process data frame came after the cycle it belongs to"), late);
    v.visit(field("link_node_reset", "", "a node announced its start"), node_reset);
    v.visit(field("link_heartbeat_lost", "", "a heartbeat stayed away, or a node left Operational"), heartbeat_lost);
    v.visit(field("link_duplicate_node", "", "two devices answer to one node id"), duplicate_node);
    v.visit(field("link_emergency", "", "an emergency message arrived"), emergency);
    v.visit(field("link_emergency_warning", "", "one that is a warning arrived"), emergency_warning);
    v.visit(field("link_intruder", "", "somebody else sent NMT, SYNC or set-points, or wrote to a node"), intruder);
    v.visit(field("link_transmit_stalled", "", "the last frames have not left these interfaces yet"), transmit_stalled);
    v.visit(field("link_error_passive", "", "these interfaces are error-passive"), error_passive);
    v.visit(field("link_bus_off", "", "these interfaces are bus-off"), bus_off);
    v.visit(field("link_send_failed", "", "own frames could not be sent over these interfaces"), send_failed);
    v.visit(field("link_outputs_missed", "", "these drives did not take their outputs"), outputs_missed);
    v.visit(field("link_device_state", "", "these devices of a segment left OP"), device_state);
    v.visit(field("link_clock_lost", "", "the clocks of these devices are not with the cycles"), clock_lost);
    v.visit(
        field("link_port_errors", "", "a port counts errors, or these devices are behind one without a link"),
        port_errors,
    );
    let Timing { sync_late_ns, compute_late_ns, last_compute_ns, skipped, suspended } = timing;
    v.visit(
        field("sync_late_ns", "ns", "frames were taken and SYNC was sent, after the planned moment of SYNC"),
        sync_late_ns,
    );
    v.visit(
        field("compute_late_ns", "ns", "frames were taken and the computation began, after its planned begin"),
        compute_late_ns,
    );
    v.visit(field("last_compute_ns", "ns", "duration of the computation of the cycle before"), last_compute_ns);
    v.visit(field("skipped", "cycles", "grid points without a cycle since the last one"), skipped);
    v.visit(field("suspended", "", "the computer was suspended since the last cycle"), suspended);
    v.visit(field("request", "", "what the person asks for"), request);
}

/// Fields of one drive: arrived, angle, state, follows, voltage, warning.
const LEFT: [Field; 6] = [
    Field { name: "left_has_angle", unit: "", meaning: "the left drive's process data arrived" },
    Field { name: "left_angle_rad", unit: "rad", meaning: "angle of the left proximal link" },
    Field { name: "left_state", unit: "", meaning: "last known state of the left drive" },
    Field { name: "left_follows_command", unit: "", meaning: "the left drive follows its command value" },
    Field { name: "left_has_voltage", unit: "", meaning: "the power stage of the left drive has voltage" },
    Field { name: "left_has_warning", unit: "", meaning: "the left drive warns" },
];
const RIGHT: [Field; 6] = [
    Field { name: "right_has_angle", unit: "", meaning: "the right drive's process data arrived" },
    Field { name: "right_angle_rad", unit: "rad", meaning: "angle of the right proximal link" },
    Field { name: "right_state", unit: "", meaning: "last known state of the right drive" },
    Field { name: "right_follows_command", unit: "", meaning: "the right drive follows its command value" },
    Field { name: "right_has_voltage", unit: "", meaning: "the power stage of the right drive has voltage" },
    Field { name: "right_has_warning", unit: "", meaning: "the right drive warns" },
];

fn drive<V: Visitor>(drive: &mut DriveSample, v: &mut V, fields: &[Field; 6]) {
    let DriveSample { angle_rad, state, follows_command, has_voltage, has_warning } = drive;
    let [arrived, angle, state_field, follows, voltage, warning] = *fields;
    optional(v, arrived, angle, angle_rad);
    v.visit(state_field, state);
    v.visit(follows, follows_command);
    v.visit(voltage, has_voltage);
    v.visit(warning, has_warning);
}

fn sample<V: Visitor>(target: &mut Option<RawSample>, v: &mut V) {
    let mut is_there = target.is_some();
    let mut sample = target.unwrap_or_default();
    v.visit(field("has_sample", "", "a force sample arrived"), &mut is_there);
    let RawSample { counts: [fx, fy, fz, tx, ty, tz], sequence, overload, invalid, age_ns } = &mut sample;
    v.visit_if(is_there, field("sample_fx_counts", "counts", "first channel of the force sensor"), fx);
    v.visit_if(is_there, field("sample_fy_counts", "counts", "second channel"), fy);
    v.visit_if(is_there, field("sample_fz_counts", "counts", "third channel"), fz);
    v.visit_if(is_there, field("sample_tx_counts", "counts", "fourth channel"), tx);
    v.visit_if(is_there, field("sample_ty_counts", "counts", "fifth channel"), ty);
    v.visit_if(is_there, field("sample_tz_counts", "counts", "sixth channel"), tz);
    optional(
        v,
        field("sample_has_sequence", "", "the sample has the sensor's own counter"),
        field("sample_sequence", "", "the sensor's own counter of samples"),
        sequence,
    );
    v.visit_if(is_there, field("sample_overload", "", "the sensor's overload bit"), overload);
    v.visit_if(is_there, field("sample_invalid", "", "the sensor says that the counts are not valid"), invalid);
    v.visit_if(is_there, field("sample_age_ns", "ns", "time since the last frame of the sample came"), age_ns);
    *target = is_there.then_some(sample);
}

fn outputs<V: Visitor>(record: &mut CycleRecord, v: &mut V) {
    let (mut kind, [mut left, mut right]) = match record.command {
        JointCommand::Position(angles) => (CommandKind::Position, angles.to_array()),
        JointCommand::Velocity(rates) => (CommandKind::Velocity, rates.to_array()),
        JointCommand::Torque(torques) => (CommandKind::Torque, torques.to_array()),
    };
    v.visit(field("command_kind", "", "kind of the joint commands"), &mut kind);
    v.visit(field("command_left", "rad, rad/s or N m", "command of the left joint, by `command_kind`"), &mut left);
    v.visit(field("command_right", "rad, rad/s or N m", "command of the right joint, by `command_kind`"), &mut right);
    record.command = match kind {
        CommandKind::Position => JointCommand::Position(JointAngles::new(left, right)),
        CommandKind::Velocity => JointCommand::Velocity(JointRates::new(left, right)),
        CommandKind::Torque => JointCommand::Torque(JointTorques::new(left, right)),
    };
    let Directive { state, motion, goal, fault_reset, is_silent } = &mut record.directive;
    v.visit(field("state", "", "state of the supervisor"), state);
    v.visit(field("motion", "", "what the reference does"), motion);
    v.visit(field("goal", "", "where the drives shall go"), goal);
    v.visit(field("fault_reset", "", "drives in Fault get a reset edge"), fault_reset);
    v.visit(field("is_silent", "", "nothing is sent any more"), is_silent);
    let mut has_cause = record.cause.is_some();
    let mut cause = record.cause.unwrap_or(Cause { fault: Fault::StopRequested, devices: DeviceSet::NONE });
    v.visit(field("has_cause", "", "a fault led to the state"), &mut has_cause);
    v.visit_if(has_cause, field("cause", "", "that fault"), &mut cause.fault);
    v.visit_if(has_cause, field("cause_devices", "", "the devices that it concerns"), &mut cause.devices);
    record.cause = has_cause.then_some(cause);
    signals(&mut record.signals, v);
}

fn signals<V: Visitor>(signals: &mut Signals, v: &mut V) {
    let Signals {
        force,
        force_age_s,
        tool,
        proxy,
        surface,
        target_angles,
        measured_angles,
        signed_distance_m,
        is_on_surface,
        hold_counter,
        is_impact,
        is_saturated,
    } = signals;
    v.visit(field("force_x_n", "N", "force of the hand on the tool as sensed, base frame"), &mut force.0.x);
    v.visit(field("force_y_n", "N", "the same, y"), &mut force.0.y);
    v.visit(field("force_age_s", "s", "age of the sample that the force comes from"), force_age_s);
    v.visit(field("tool_x_m", "m", "tool point by the measured angles, base frame"), &mut tool.0.x);
    v.visit(field("tool_y_m", "m", "the same, y"), &mut tool.0.y);
    v.visit(field("proxy_x_m", "m", "proxy; the tool point while there is no reference"), &mut proxy.0.x);
    v.visit(field("proxy_y_m", "m", "the same, y"), &mut proxy.0.y);
    v.visit(
        field("surface_x_m", "m", "how far the surfaces have moved from their place, base frame"),
        &mut surface.0.x,
    );
    v.visit(field("surface_y_m", "m", "the same, y"), &mut surface.0.y);
    v.visit(field("target_left_rad", "rad", "left angle that the proxy asks for"), &mut target_angles.0.x);
    v.visit(field("target_right_rad", "rad", "right angle that the proxy asks for"), &mut target_angles.0.y);
    v.visit(field("measured_left_rad", "rad", "left angle as measured or predicted"), &mut measured_angles.0.x);
    v.visit(field("measured_right_rad", "rad", "right angle as measured or predicted"), &mut measured_angles.0.y);
    v.visit(
        field("signed_distance_m", "m", "distance of the proxy from the surface, negative on the forbidden side"),
        signed_distance_m,
    );
    v.visit(field("is_on_surface", "", "the fixture keeps the proxy on the surface"), is_on_surface);
    v.visit(field("hold_counter", "cycles", "cycles for which the proxy is still held"), hold_counter);
    v.visit(field("is_impact", "", "the proxy met the surface in this cycle"), is_impact);
    v.visit(field("is_saturated", "", "a torque was cut to its limit"), is_saturated);
}

fn truth<V: Visitor>(target: &mut Option<Truth>, v: &mut V) {
    let mut is_there = target.is_some();
    let mut truth = target.unwrap_or_default();
    v.visit(field("has_truth", "", "the rig is simulated: what follows is known"), &mut is_there);
    v.visit_if(is_there, field("true_tool_x_m", "m", "tool point of the simulation, base frame"), &mut truth.tool.0.x);
    v.visit_if(is_there, field("true_tool_y_m", "m", "the same, y"), &mut truth.tool.0.y);
    v.visit_if(
        is_there,
        field("true_velocity_x_m_per_s", "m/s", "velocity of the tool in the simulation"),
        &mut truth.velocity.0.x,
    );
    v.visit_if(is_there, field("true_velocity_y_m_per_s", "m/s", "the same, y"), &mut truth.velocity.0.y);
    v.visit_if(
        is_there,
        field("true_torque_left_n_m", "N m", "torque of the left drive in the simulation"),
        &mut truth.torques.0.x,
    );
    v.visit_if(
        is_there,
        field("true_torque_right_n_m", "N m", "torque of the right drive in the simulation"),
        &mut truth.torques.0.y,
    );
    *target = is_there.then_some(truth);
}
