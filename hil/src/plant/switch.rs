//! Home and limit switches.

use super::noise::Noise;

/// A home or limit switch, closed within an interval of motor angles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Switch {
    /// Lowest angle at which the switch is closed, rad.
    pub from: f64,
    /// Highest angle at which the switch is closed, rad.
    pub to: f64,
    /// Bounce time of the contact after each edge, sub-steps of 100 µs.
    pub bounce: u32,
}

#[derive(Clone, Debug)]
pub(crate) struct Contact {
    switch: Switch,
    pressed: bool,
    chatter: u32,
    pub(super) closed: bool,
}

impl Contact {
    pub(crate) fn new(switch: &Switch, angle: f64) -> Self {
        let pressed = (switch.from..=switch.to).contains(&angle);
        Self { switch: *switch, pressed, chatter: 0, closed: pressed }
    }

    /// Reads the shaft angle. `elapsed` counts the sub-steps since the last reading.
    pub(crate) fn advance(&mut self, angle: f64, elapsed: u32, noise: &mut Noise) {
        let pressed = (self.switch.from..=self.switch.to).contains(&angle);
        if pressed == self.pressed {
            self.chatter = self.chatter.saturating_sub(elapsed);
        } else {
            self.pressed = pressed;
            self.chatter = self.switch.bounce;
        }
        self.closed = if self.chatter > 0 { noise.bits() & 1 == 1 } else { self.pressed };
    }
}

#[cfg(test)]
mod tests {
    use super::{Contact, Switch};
    use crate::plant::Noise;

    #[test]
    fn switch_is_closed_exactly_between_its_edges() {
        let switch = Switch { from: -1.0, to: 2.0, bounce: 0 };
        let mut contact = Contact::new(&switch, -5.0);
        for (angle, closed) in [(-1.001, false), (-1.0, true), (0.0, true), (2.0, true), (2.001, false)] {
            contact.advance(angle, 10, &mut Noise::new(0));
            assert_eq!(contact.closed, closed, "at {angle}");
        }
        assert!(Contact::new(&switch, 1.0).closed, "power-on on the switch");
    }

    #[test]
    fn contact_chatters_for_its_bounce_and_then_settles() {
        let switch = Switch { from: 0.0, to: 1.0, bounce: 30 };
        let mut noise = Noise::new(3);
        let mut contact = Contact::new(&switch, -1.0);
        let readings: Vec<bool> = (0..60)
            .map(|_| {
                contact.advance(0.5, 1, &mut noise);
                contact.closed
            })
            .collect();
        assert!(readings[..30].contains(&false) && readings[..30].contains(&true), "{readings:?}");
        assert!(readings[30..].iter().all(|closed| *closed), "{readings:?}");
    }

    #[test]
    fn chatter_lasts_as_long_however_often_it_is_looked_at() {
        let switch = Switch { from: 0.0, to: 1.0, bounce: 30 };
        for elapsed in [1, 10, 20] {
            let settled = |seed| {
                let mut contact = Contact::new(&switch, -1.0);
                let mut noise = Noise::new(seed);
                for _ in 0..=30_u32.div_ceil(elapsed) {
                    contact.advance(0.5, elapsed, &mut noise);
                }
                contact.closed
            };
            assert!((0..20).all(settled), "every {elapsed} sub-steps");
        }
    }
}
