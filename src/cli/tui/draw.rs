//! Drawing of the screen.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Paragraph};

use super::keys::Act;
use super::view::{CLASSES, View};
use crate::printable::printable;
use yieldwall_motion::elementary::hypot;
use yieldwall_motion::guard::State;
use yieldwall_run::explanation::state_name;

/// Least that anything can be read on, in columns and rows.
const LEAST: (u16, u16) = (40, 8);
/// Rows of the histogram below its head.
const BARS: usize = 8;

/// Current actions of the keys.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Offer {
    /// A stop was asked for.
    pub(super) is_stopping: bool,
    /// The loop takes orders to reset and to enable.
    pub(super) can_come_back: bool,
    /// Act that waits for the second key.
    pub(super) armed: Option<Act>,
}

/// Draws all of it; on a screen that is too small, the state and how to stop.
pub(super) fn draw(frame: &mut Frame<'_>, view: &View, offer: Offer) {
    let area = frame.area();
    let in_color = std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    let keys = keys(view.state, offer, in_color);
    if area.width < LEAST.0 || area.height < LEAST.1 {
        let state = Line::from(format!("{:?}", view.state));
        frame.render_widget(Paragraph::new(vec![state, keys]), area);
        return;
    }
    let [head, axes, motion, rest, foot] = Layout::vertical([
        Constraint::Length(2),
        Constraint::Length(3),
        Constraint::Length(2),
        Constraint::Min(1),
        Constraint::Length(1),
    ])
    .areas(area);
    frame.render_widget(Paragraph::new(head_lines(view, in_color)), head);
    frame.render_widget(Paragraph::new(axis_lines(view)), axes);
    frame.render_widget(Paragraph::new(motion_lines(view)), motion);
    // Side by side where there is room for both.
    let [late, log] = if area.width >= 80 {
        Layout::horizontal([Constraint::Length(32), Constraint::Min(1)]).areas(rest)
    } else {
        [Rect::default(), rest]
    };
    if late.width > 0 {
        frame.render_widget(Paragraph::new(late_lines(view)).block(Block::bordered().title("late by, cycles")), late);
    }
    let width = usize::from(log.width.saturating_sub(2));
    let rows = usize::from(log.height.saturating_sub(2));
    frame.render_widget(
        Paragraph::new(log_lines(view, width, rows, in_color)).block(Block::bordered().title("events")),
        log,
    );
    frame.render_widget(Paragraph::new(keys), foot);
}

fn keys(state: State, offer: Offer, in_color: bool) -> Line<'static> {
    if offer.is_stopping {
        return Line::from("stopping along the ramp; the program ends when no drive makes torque");
    }
    let style = Style::new().add_modifier(Modifier::BOLD | Modifier::REVERSED);
    let style = if in_color { style.fg(Color::Red) } else { style };
    let more = match offer.armed {
        Some(Act::Reset) => " Enter: reset; any other key: not",
        Some(Act::Enable) => " Enter: THE DRIVES ARE ENABLED; any other key: not",
        _ if offer.can_come_back && state.is_latched() => " or q; r, Enter: reset, which enables nothing",
        _ if offer.can_come_back && state == State::Idle => " or q; e, Enter: enable the drives again",
        _ => " also Esc, q, Ctrl-C; the program ends then",
    };
    Line::from(vec![Span::styled(" STOP: Space ", style), Span::raw(more)])
}

fn head_lines(view: &View, in_color: bool) -> Vec<Line<'static>> {
    let color = match view.state {
        State::Running => Color::Green,
        State::Holding | State::Stopping => Color::Yellow,
        State::Stopped | State::Disabled | State::Lost => Color::Red,
        State::Idle | State::Enabling => Color::Blue,
    };
    let style = Style::new().add_modifier(Modifier::BOLD);
    let state =
        Span::styled(format!("{:9}", format!("{:?}", view.state)), if in_color { style.fg(color) } else { style });
    let time = view.time_s.map_or_else(|| "-".to_owned(), |time_s| format!("{time_s:.2}"));
    let of = format!(" {time:>8} of {} s", view.duration_s);
    vec![
        Line::from(printable(&format!("{}, {}", view.rig, view.place)).into_owned()),
        Line::from(vec![state, Span::raw(of)]),
    ]
}

fn axis_lines(view: &View) -> Vec<Line<'static>> {
    let head = format!("{:10} {:22} {:>12} {:>11} {:>11}", "axis", "state", "position/rad", "target/rad", "torque/N m");
    let axes = view.axes.iter().map(|axis| {
        let state = axis.state.map_or("-", |state| state_name(Some(state)));
        let torque = axis.torque_n_m.map_or_else(|| "-".to_owned(), |torque| format!("{torque:.3}"));
        let name: String = printable(&axis.name).chars().take(10).collect();
        format!("{name:10} {state:22} {:>12.4} {:>11.4} {torque:>11}", axis.position_rad, axis.target_rad)
    });
    std::iter::once(head).chain(axes).map(Line::from).collect()
}

fn motion_lines(view: &View) -> Vec<Line<'static>> {
    let ([fx, fy], [px, py], [tx, ty]) = (view.force_n, view.proxy_m, view.tool_m);
    let off_mm = 1e3 * hypot(tx - px, ty - py);
    let surface = if view.is_on_surface { ", on the surface" } else { "" };
    vec![
        Line::from(format!("force      {:7.2} N   x {fx:8.2}  y {fy:8.2}", hypot(fx, fy))),
        Line::from(format!("proxy   x {:8.2}  y {:8.2} mm, tool {off_mm:.2} mm off{surface}", 1e3 * px, 1e3 * py)),
    ]
}

/// Returns a row for each class with cycles; it combines neighbours if there are many.
fn late_lines(view: &View) -> Vec<Line<'static>> {
    let last = view.late.iter().rposition(|count| *count > 0).unwrap_or(0);
    let first = view.late.iter().position(|count| *count > 0).unwrap_or(0).max((last + 1).saturating_sub(BARS));
    let below: u64 = view.late[..first].iter().sum();
    let rows = (first..=last).map(|class| {
        let count = view.late[class] + if class == first { below } else { 0 };
        let bar = "#".repeat(count.checked_ilog10().map_or(0, |digits| digits as usize + 1));
        let bound = if class + 1 == CLASSES { "more".to_owned() } else { format!("< {} us", 1u64 << (class + 1)) };
        format!("{bound:>11} {count:>9} {bar}")
    });
    let most = std::iter::once(format!("{:>11} {:>6.0} us", "at most", view.worst_us));
    most.chain(rows).map(Line::from).collect()
}

/// Returns the latest events that fit, with all rows of each.
fn log_lines(view: &View, width: usize, rows: usize, in_color: bool) -> Vec<Line<'static>> {
    let mut lines: Vec<Line<'static>> = Vec::new();
    for event in view.log.iter().rev() {
        let time = event.time_s.map_or_else(|| "-".to_owned(), |time_s| format!("{time_s:.2}"));
        let words: String = event.words.iter().map(|(key, text)| format!("; {key}: {text}")).collect();
        let text = format!("{time:>7} {} {}{words}", event.name, event.text);
        let style = if in_color && event.is_grave() { Style::new().fg(Color::Red) } else { Style::new() };
        let wrapped =
            textwrap::wrap(&printable(&text), textwrap::Options::new(width.max(10)).subsequent_indent("        "))
                .into_iter()
                .map(|line| Line::styled(line.into_owned(), style))
                .collect::<Vec<_>>();
        if lines.len() + wrapped.len() > rows {
            // The newest event shows at least its beginning.
            if lines.is_empty() {
                lines = wrapped.into_iter().take(rows).collect();
            }
            break;
        }
        lines.splice(0..0, wrapped);
    }
    lines
}

#[cfg(test)]
mod tests {
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    use super::*;
    use crate::events::Event;

    fn view() -> View {
        let mut view = View::new("paper-admittance", ["left", "right"], "can0, by the wall clock", 27.0);
        view.state = State::Stopped;
        view.time_s = Some(2.5);
        view.force_n = [3.0, 4.0];
        view.late[5] = 1200;
        view.late[9] = 1;
        view.worst_us = 700.0;
        let words = vec![("cause", "its supply dipped".to_owned()), ("next", "check the node's supply".to_owned())];
        let fault = Event::new("fault", Some(2.5), "node-reset (frames, left drive): a node restarted").meaning(words);
        view.tell(&Event::new("enabled", None, "the rig runs"));
        view.tell(&fault);
        view
    }

    fn screen(view: &View, width: u16, height: u16, offer: Offer) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, view, offer)).unwrap();
        let buffer = terminal.backend().buffer();
        let rows = buffer.content().chunks(usize::from(width).max(1));
        rows.map(|row| row.iter().map(|cell| cell.symbol()).collect::<String>().trim_end().to_owned() + "\n").collect()
    }

    #[test]
    fn a_usual_terminal_shows_axes_force_lateness_and_the_fault_in_words() {
        let seen = screen(&view(), 80, 24, Offer::default());
        for text in [
            "paper-admittance, can0",
            "Stopped       2.50 of 27 s",
            "position/rad",
            "force         5.00 N",
            "at most    700 us",
            "node-reset",
            "cause: its supply",
            "check the node's supply",
            "STOP: Space",
        ] {
            assert!(seen.contains(text), "{text}:\n{seen}");
        }
        let stopping = Offer { is_stopping: true, ..Offer::default() };
        assert!(screen(&view(), 80, 24, stopping).contains("stopping along the ramp"));
    }

    /// Only a rig that can come back offers reset and enable, and only those that its state accepts.
    #[test]
    fn reset_and_enabling_are_offered_where_the_rig_takes_them() {
        let back = Offer { can_come_back: true, ..Offer::default() };
        let in_state = |state, offer| screen(&View { state, ..view() }, 80, 24, offer);
        assert!(in_state(State::Stopped, back).contains("r, Enter: reset"));
        assert!(in_state(State::Idle, back).contains("e, Enter: enable"));
        for (state, offer) in [(State::Running, back), (State::Stopped, Offer::default())] {
            let seen = in_state(state, offer);
            assert!(!seen.contains("Enter:") && seen.contains("STOP: Space"), "{seen}");
        }
        let armed = |act| in_state(State::Stopped, Offer { armed: Some(act), ..back });
        assert!(armed(Act::Reset).contains("Enter: reset") && armed(Act::Enable).contains("DRIVES ARE ENABLED"));
    }

    /// However small a terminal is, it says how to stop.
    #[test]
    fn every_size_says_the_state_and_how_to_stop() {
        for (width, height) in [(80, 24), (60, 12), (40, 8), (30, 4), (14, 2), (200, 60)] {
            let seen = screen(&view(), width, height, Offer::default());
            assert!(seen.contains("STOP: Space") && seen.contains("Stopped"), "{width}x{height}:\n{seen}");
        }
        for (width, height) in [(1, 1), (0, 0), (3, 30)] {
            screen(&view(), width, height, Offer::default());
        }
    }
}
