//! Acts of the keys: one key stops, two keys reset or enable.

use std::time::{Duration, Instant};

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

/// Time for which the first of two keys waits for the second.
const PATIENCE: Duration = Duration::from_secs(5);

/// Act that a key requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Act {
    Stop = 1,
    Reset,
    Enable,
}

impl Act {
    /// Returns the act of a number; 0 is none.
    pub(super) fn of(number: u8) -> Option<Self> {
        [Self::Stop, Self::Reset, Self::Enable].into_iter().find(|act| *act as u8 == number)
    }
}

/// The first of two keys, while it waits for the second.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Keys {
    armed: Option<(Act, Instant)>,
}

impl Keys {
    /// Returns the act that waits for Enter.
    pub(super) fn armed(&self, now: Instant) -> Option<Act> {
        self.armed.filter(|(_, at)| now.duration_since(*at) <= PATIENCE).map(|(act, _)| act)
    }

    /// Takes a key, and returns the requested act. Space, q, Esc and Ctrl-C stop, whatever was pressed before. If a rig can come
    /// back, r or e and then Enter reset or enable; any other key between them cancels the first one.
    pub(super) fn press(&mut self, key: &KeyEvent, now: Instant, can_come_back: bool) -> Option<Act> {
        if key.kind == KeyEventKind::Release {
            return None;
        }
        let armed = self.armed(now);
        self.armed = None;
        let is_control = key.modifiers.contains(KeyModifiers::CONTROL);
        match key.code {
            KeyCode::Char(' ' | 'q' | 'Q') | KeyCode::Esc => Some(Act::Stop),
            KeyCode::Char('c') if is_control => Some(Act::Stop),
            // A key that is held down is pressed once.
            KeyCode::Enter if key.kind == KeyEventKind::Press => armed.filter(|_| can_come_back),
            KeyCode::Char('r' | 'R') if can_come_back => {
                self.armed = Some((Act::Reset, now));
                None
            }
            KeyCode::Char('e' | 'E') if can_come_back => {
                self.armed = Some((Act::Enable, now));
                None
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn press(keys: &mut Keys, code: KeyCode, now: Instant) -> Option<Act> {
        keys.press(&KeyEvent::new(code, KeyModifiers::NONE), now, true)
    }

    #[test]
    fn the_keys_that_stop_do_so_whatever_came_before() {
        let now = Instant::now();
        let mut keys = Keys::default();
        for code in [KeyCode::Char(' '), KeyCode::Char('q'), KeyCode::Char('Q'), KeyCode::Esc] {
            assert_eq!(press(&mut keys, KeyCode::Char('r'), now), None);
            assert_eq!(press(&mut keys, code, now), Some(Act::Stop), "{code:?}");
            assert_eq!(keys.armed(now), None, "a stop undoes what was begun");
        }
        let control_c = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        assert_eq!(keys.press(&control_c, now, false), Some(Act::Stop));
        assert_eq!(press(&mut keys, KeyCode::Char('c'), now), None);
        for act in [Act::Stop, Act::Reset, Act::Enable] {
            assert_eq!(Act::of(act as u8), Some(act));
        }
        assert_eq!(Act::of(0), None);
    }

    #[test]
    fn reset_and_enabling_take_two_keys_in_time_and_nothing_between() {
        let now = Instant::now();
        for (code, act) in [(KeyCode::Char('r'), Act::Reset), (KeyCode::Char('E'), Act::Enable)] {
            let mut keys = Keys::default();
            assert_eq!(press(&mut keys, code, now), None);
            assert_eq!(keys.armed(now), Some(act));
            assert_eq!(press(&mut keys, KeyCode::Enter, now + PATIENCE), Some(act));
            assert_eq!(press(&mut keys, KeyCode::Enter, now + PATIENCE), None, "once");
            press(&mut keys, code, now);
            assert_eq!(press(&mut keys, KeyCode::Enter, now + PATIENCE * 2), None, "too late");
            press(&mut keys, code, now);
            press(&mut keys, KeyCode::Char('x'), now);
            assert_eq!(press(&mut keys, KeyCode::Enter, now), None, "another key between");
            let mut alone = Keys::default();
            assert_eq!(alone.press(&KeyEvent::new(code, KeyModifiers::NONE), now, false), None);
            assert_eq!(alone.armed(now), None, "where no rig comes back");
        }
    }
}
