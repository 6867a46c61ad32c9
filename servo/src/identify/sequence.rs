//! Periodic excitation sequences.

use std::f64::consts::{PI, TAU};

/// At most `count` multiples of the fundamental frequency from `low` to `high`, Hz, evenly spaced on a logarithmic
/// axis. All multiples are different, and the fundamental itself is not used. `dt` is the period of the servo, s.
pub fn lines(length: usize, dt: f64, [low, high]: [f64; 2], count: usize) -> Vec<usize> {
    let bins = length as f64 * dt;
    let step = (high / low).powf(1.0 / (count.max(2) - 1) as f64);
    let mut lines: Vec<usize> = Vec::new();
    for number in 0..count {
        let wanted = (low * step.powi(number as i32) * bins).round() as usize;
        let least = lines.last().map_or(2, |last| last + 1);
        let line = wanted.max(least);
        if line as f64 <= high * bins + 0.5 && 2 * line < length {
            lines.push(line);
        }
    }
    lines
}

/// Sum of sines of equal amplitude at `lines`, with phases by Schroeder (IEEE Trans. Inf. Theory 16 (1970) 85). The
/// greatest value is `amplitude`.
pub fn multisine(length: usize, lines: &[usize], amplitude: f64) -> Vec<f64> {
    let count = lines.len().max(1) as f64;
    let value = |at: usize| -> f64 {
        let sine = |(number, &line): (usize, &usize)| {
            let phase = -PI * (number * (number + 1)) as f64 / count;
            // The product is reduced first, because a sine of thousands of turns would lose its last digits.
            let turn = (line * at % length) as f64 / length as f64;
            (TAU * turn + phase).cos()
        };
        lines.iter().enumerate().map(sine).sum()
    };
    scaled((0..length).map(value).collect(), amplitude)
}

/// A sine whose frequency rises from the first of `lines` to the last, with equal time for each octave.
pub fn chirp(length: usize, lines: &[usize], amplitude: f64) -> Vec<f64> {
    let (Some(&first), Some(&last)) = (lines.first(), lines.last()) else {
        return vec![0.0; length];
    };
    let (first, rise) = (first as f64, (last as f64 / first as f64).ln().max(1e-9));
    let value = |at: usize| {
        let share = at as f64 / length as f64;
        (TAU * first * ((share * rise).exp() - 1.0) / rise).sin()
    };
    scaled((0..length).map(value).collect(), amplitude)
}

fn scaled(mut values: Vec<f64>, amplitude: f64) -> Vec<f64> {
    let most = values.iter().fold(0.0, |most: f64, it| most.max(it.abs()));
    if most > 0.0 {
        values.iter_mut().for_each(|it| *it *= amplitude / most);
    }
    values
}
