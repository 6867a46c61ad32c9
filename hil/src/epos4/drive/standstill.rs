//! Standstill of the axis, which bit 12 of the statusword shows in profile velocity mode.
//!
//! An EPOS4 has object 0x30E0 where CiA 402-2 §14 has 0x606F and 0x6070: a window about zero, a time and a time-out.
//! Standstill begins when the velocity has been within the window for the time. Standstill ends when the velocity has
//! been outside the window for the time (CiA 402-2 §14). The maxon documents at hand do not define the end of
//! standstill.

/// Object 0x30E0, in s and counts/s.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    /// Velocity up to which an axis counts as standing.
    pub(super) velocity: f64,
    /// Time for which the velocity must stay on the other side of the window.
    pub(super) time: f64,
    /// Time after which an axis with a demanded velocity of zero counts as standing.
    pub(super) time_out: f64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Standstill {
    pub(super) reached: bool,
    /// Time for which the velocity has contradicted the present result, s.
    contradicted: f64,
    /// Time for which the demanded velocity has been zero, s.
    told: f64,
}

impl Standstill {
    /// The state of a standing axis.
    pub(super) const REACHED: Self = Self { reached: true, contradicted: 0.0, told: 0.0 };

    /// Advances by `dt`, s, at a velocity in counts/s. `told`: the demanded velocity is zero.
    pub(super) fn advance(&mut self, velocity: f64, told: bool, window: &Window, dt: f64) {
        self.told = if told { self.told + dt } else { 0.0 };
        let given_up = told && self.told >= window.time_out;
        let stands = velocity.abs() <= window.velocity || given_up;
        if stands == self.reached {
            self.contradicted = 0.0;
            return;
        }
        self.contradicted += dt;
        if given_up || self.contradicted >= window.time {
            self.reached = stands;
            self.contradicted = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Standstill, Window};

    const WINDOW: Window = Window { velocity: 10.0, time: 2.0, time_out: 10.0 };

    /// Whether the axis stands after each second at these velocities.
    fn check(velocities: &[f64], told: bool, expected: &str) {
        let mut standstill = Standstill::REACHED;
        let found: String = velocities
            .iter()
            .map(|&velocity| {
                standstill.advance(velocity, told, &WINDOW, 1.0);
                if standstill.reached { '0' } else { '1' }
            })
            .collect();
        assert_eq!(found, expected, "{velocities:?}");
    }

    #[test]
    fn a_velocity_counts_once_it_has_lasted() {
        check(&[10.0, -10.0, 10.0, 10.0], false, "0000");
        check(&[11.0, 11.0, 0.0, 0.0], false, "0110");
        check(&[-11.0, -11.0, -11.0, 10.0, 11.0, 10.0], false, "011111");
        check(&[11.0, 0.0, 11.0, 0.0, 11.0, 11.0], false, "000001");
    }

    #[test]
    fn an_axis_told_to_stand_stands_after_the_time_out() {
        check(&[20.0; 14], true, "01111111100000");
        check(&[20.0; 14], false, "01111111111111");
    }
}
