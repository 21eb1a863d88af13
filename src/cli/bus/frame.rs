//! One frame of a budget: a row of the table, figures for a program, a sentence.

use serde_json::{Value, json};

use yieldwall_bus::budget::{FrameBudget, Moment, Use};

/// Longest name of a frame that the table shows whole.
pub(super) const NAME_WIDTH: usize = 22;

/// Returns the longest time in whole us, rounded up.
fn response_us(frame: &FrameBudget) -> Option<u64> {
    frame.response_ns.map(|response| response.div_ceil(1000))
}

fn deadline_us(frame: &FrameBudget) -> u64 {
    frame.deadline_ns / 1000
}

pub(super) fn figures(frame: &FrameBudget) -> Value {
    json!({
        "name": frame.frame.name,
        "cob_id": frame.frame.cob_id,
        "bytes": frame.frame.bytes,
        "bits_worst": frame.frame.bits_worst(),
        "bits_longest": frame.frame.bits_longest(),
        "period_us": frame.frame.period.as_micros() as u64,
        "response_time_us": response_us(frame),
        "deadline_us": deadline_us(frame),
        "from": moment(frame.from),
        "occasional": frame.is_occasional(),
        "in_time": frame.is_in_time(),
    })
}

pub(super) fn row(frame: &FrameBudget, is_plain: bool) -> String {
    let FrameBudget { frame: planned, from, .. } = frame;
    let longest = response_us(frame);
    let slack = longest.map(|longest| i128::from(deadline_us(frame)) - i128::from(longest));
    let or_none = |value: Option<String>| value.unwrap_or_else(|| "none".to_owned());
    format!(
        "{:03X}h  {:<NAME_WIDTH$} {:>5} {:>4} {:>7} {:>7} {:>7} {:>7}  {}{}",
        planned.cob_id,
        shortened(&planned.name),
        planned.bytes,
        planned.bits(is_plain),
        planned.period.as_micros(),
        or_none(longest.map(|us| us.to_string())),
        deadline_us(frame),
        or_none(slack.map(|us| us.to_string())),
        moment(*from),
        if frame.is_occasional() { " *" } else { "" },
    )
}

fn shortened(name: &str) -> String {
    if name.chars().count() <= NAME_WIDTH {
        return name.to_owned();
    }
    // The end says which frame it is.
    let end: Vec<char> = name.chars().rev().take(NAME_WIDTH - 1).collect();
    format!("…{}", end.into_iter().rev().collect::<String>())
}

fn moment(from: Moment) -> &'static str {
    match from {
        Moment::Sync => "sync",
        Moment::Compute => "step",
        Moment::Release => "queue",
    }
}

/// Describes a frame's slack against its deadline.
pub(super) fn verdict(frame: &FrameBudget) -> String {
    let what = format!("{:03X}h {}", frame.frame.cob_id, frame.frame.name);
    let by = match (frame.frame.usage, frame.from) {
        (Use::Sync | Use::Measured, Moment::Sync) => "the control step",
        (Use::SetPoint, Moment::Compute) => "the next SYNC",
        _ => "its next period",
    };
    match (frame.late_ns(), response_us(frame)) {
        (Some(0), Some(response)) => {
            format!("{what} arrives at least {} us before {by}", deadline_us(frame) - response)
        }
        (Some(late), _) => format!("{what} can arrive up to {} us after {by}", late.div_ceil(1000)),
        (None, _) => format!("{what} has no upper bound: it can fall behind further in every cycle"),
    }
}
