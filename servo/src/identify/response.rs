//! Frequency response, computed from several periods of input and output.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};

/// Kind of a frequency response.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Response {
    /// The open loop, from which crossover and margin are read.
    Open,
    /// The closed loop, from command to sample.
    Closed,
}

/// The response at one frequency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Hz.
    pub frequency: f64,
    /// Output per input.
    pub magnitude: f64,
    /// rad, without jumps from point to point.
    pub phase: f64,
    /// Coherence of the periods, 0 to 1. A point below 0.9 is unreliable.
    pub coherence: f64,
}

/// Quality of a loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margin {
    /// Frequency at which the open loop's magnitude finally falls below 1, Hz.
    pub crossover: f64,
    /// Phase margin: phase above half a turn at the crossover, rad.
    pub phase: f64,
}

/// The response at `lines`, computed from the whole periods of `length` samples in `input` and `output`, with a sample
/// each `dt` seconds.
///
/// Every two successive periods are a block, so at least two periods are needed. The response is the ratio of the
/// averaged spectra. Noise in input or output is therefore not taken for a response.
pub fn respond(
    input: &[f64],
    output: &[f64],
    length: usize,
    lines: &[usize],
    dt: f64,
    response: Response,
) -> Vec<Point> {
    let periods = input.len().min(output.len()) / length;
    let starts = (1..periods).map(|block| (block - 1) * length);
    let block = |start| start..start + 2 * length;
    let blocks: Vec<_> = starts.map(|start| (&input[block(start)], &output[block(start)])).collect();
    // Initial value for the phase: about half a turn behind for an open loop, zero otherwise.
    let mut near = match response {
        Response::Open => -TAU / 2.0,
        Response::Closed => 0.0,
    };
    let point = |&line: &usize| {
        let (mut x, mut y, mut cross) = (Complex::ZERO, Complex::ZERO, Complex::ZERO);
        let (mut x_power, mut y_power) = (0.0, 0.0);
        for (input, output) in &blocks {
            let (of_x, of_y) = (transform(input, 2 * line), transform(output, 2 * line));
            (x, y) = (x.plus(of_x), y.plus(of_y));
            cross = cross.plus(of_y.over(of_x).times(of_x.power()));
            x_power += of_x.power();
            y_power += of_y.power();
        }
        let ratio = y.over(x);
        Point {
            frequency: line as f64 / (length as f64 * dt),
            magnitude: ratio.power().sqrt(),
            phase: continued(&mut near, ratio.angle()),
            coherence: cross.power() / (x_power * y_power),
        }
    };
    lines.iter().map(point).collect()
}

/// Open loop of a drive, cut at its torque, from the response of its loops to an added torque.
///
/// `answered` is the torque by which the loops oppose the added torque, and `left` is the sum of both. The drive
/// samples both at the end of each hold period of `dt` seconds. The loops of the drive turn every `drive_period`
/// seconds.
///
/// The opposing share is T = L / (1 + L), so L = T / (1 - T). A value held for a period acts half a period late, and
/// its amplitude falls at high frequencies. A sample shows the value held for one drive period, and is half a drive
/// period older than the value's effect. Both effects are compensated, since they are not part of the loop. At high
/// loop gain `left` is small, and at low loop gain `answered` is small: the coherence of a point is the lower of the
/// two.
pub(super) fn opened(answered: &[Point], left: &[Point], dt: f64, drive_period: f64) -> Vec<Point> {
    const HALF_TURN: f64 = TAU / 2.0;
    let open = |(point, left): (&Point, &Point)| {
        let turn = HALF_TURN * point.frequency * dt;
        let share = turn.sin() / turn;
        let ahead = HALF_TURN * point.frequency * (dt - drive_period);
        let taken = Complex::polar(point.magnitude / share, point.phase - ahead);
        let open = taken.over(Complex(1.0, 0.0).plus(taken.times(-1.0)));
        // At low frequencies `left` vanishes, and its noise would disturb a phase unwrapped from there.
        let mut near = -HALF_TURN;
        Point {
            magnitude: open.power().sqrt(),
            phase: continued(&mut near, open.angle()),
            coherence: point.coherence.min(left.coherence),
            ..*point
        }
    };
    answered.iter().zip(left).map(open).collect()
}

/// The angle that differs from `angle` by whole turns and is nearest to the previous angle `near`, which it replaces.
fn continued(near: &mut f64, angle: f64) -> f64 {
    *near = angle + TAU * ((*near - angle) / TAU).round();
    *near
}

/// Crossover and margin of an open loop; `None` if its magnitude does not pass 1 between two points.
pub fn margin(open: &[Point]) -> Option<Margin> {
    let (crossover, phase) = last_fall(open, 1.0)?;
    Some(Margin { crossover, phase: phase + TAU / 2.0 })
}

/// Frequency at which a closed loop finally falls below -3 dB, Hz; `None` if no two points enclose it.
pub fn bandwidth(closed: &[Point]) -> Option<f64> {
    last_fall(closed, FRAC_1_SQRT_2).map(|(frequency, _)| frequency)
}

/// Frequency and phase at which the magnitude last falls below `level`. Points are connected by straight lines on
/// logarithmic axes.
fn last_fall(points: &[Point], level: f64) -> Option<(f64, f64)> {
    let falls = |pair: &&[Point]| pair[0].magnitude >= level && pair[1].magnitude < level;
    let pair = points.windows(2).rev().find(falls)?;
    let [before, after] = [pair[0], pair[1]];
    let share = (before.magnitude / level).ln() / (before.magnitude / after.magnitude).ln();
    let frequency = before.frequency * (after.frequency / before.frequency).powf(share);
    Some((frequency, before.phase + share * (after.phase - before.phase)))
}

/// One line of the spectrum of a block under a Hann window.
fn transform(block: &[f64], line: usize) -> Complex {
    let length = block.len();
    let mut sum = Complex::ZERO;
    for (at, value) in block.iter().enumerate() {
        let window = 1.0 - (TAU * at as f64 / length as f64).cos();
        let (sin, cos) = (TAU * (line * at % length) as f64 / length as f64).sin_cos();
        sum = sum.plus(Complex(window * value * cos, -window * value * sin));
    }
    sum
}

#[derive(Clone, Copy)]
struct Complex(f64, f64);

impl Complex {
    const ZERO: Self = Self(0.0, 0.0);

    fn polar(magnitude: f64, angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        Self(magnitude * cos, magnitude * sin)
    }

    fn plus(self, other: Self) -> Self {
        Self(self.0 + other.0, self.1 + other.1)
    }

    fn times(self, factor: f64) -> Self {
        Self(self.0 * factor, self.1 * factor)
    }

    fn over(self, other: Self) -> Self {
        let Self(re, im) = other;
        Self(self.0 * re + self.1 * im, self.1 * re - self.0 * im).times(1.0 / other.power())
    }

    fn power(self) -> f64 {
        self.0 * self.0 + self.1 * self.1
    }

    fn angle(self) -> f64 {
        self.1.atan2(self.0)
    }
}
