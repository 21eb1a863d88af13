//! Injections into arm and hand.

use crate::world::{Body, Push, PushShape, World};
use yieldwall_config::injection::{Injection, Kind};

impl World {
    /// Begins an injection, or ends it.
    pub(crate) fn switch(&mut self, injection: Injection, is_on: bool) {
        let shape = match injection.kind {
            Kind::HandPush | Kind::HandOverload => PushShape::Along,
            Kind::HandBlow => PushShape::Blow,
            Kind::HandSwing => PushShape::Swing,
            Kind::HandTremble => PushShape::Tremble,
            Kind::HandToEdge => PushShape::Outward,
            Kind::HandStiff => {
                // The sizes of the catalogue keep it finite and not negative.
                let share = if is_on { injection.size } else { 1.0 };
                let _ = self.hand.set_stiffness(self.hand_stiffness_n_per_m * share);
                return;
            }
            _ => {
                if let Body::Arm(arm) = &mut self.body {
                    (0..2)
                        .filter(|joint| injection.target.has_joint(*joint))
                        .for_each(|joint| arm.set_blocked(joint, is_on));
                }
                return;
            }
        };
        let Injection { size, start_s, .. } = injection;
        let push = Push { shape, size_n: size, start_s, end_s: injection.end_s() };
        if is_on {
            self.pushes.push(push);
        } else {
            self.pushes.retain(|known| *known != push);
        }
    }
}
