//! The measuring chain from wrench to counts.

use std::time::Duration;

use can::Instant;

use super::super::transducer::{Reading, Transducer, counts, counts_16};
use super::super::{Channel, ForceSensorError, TemperatureCourse, TransducerConfig};
use super::{constant, course};

const LOAD: [f64; 6] = [10.0, -20.0, 30.0, 1.0, -2.0, 3.0];

fn at(seconds: f64) -> Instant {
    Instant::ZERO + Duration::from_secs_f64(seconds)
}

fn transducer(config: TransducerConfig, load: [f64; 6]) -> Transducer {
    Transducer::new(config, Instant::ZERO, constant(load)).unwrap()
}

fn reading(config: TransducerConfig, load: [f64; 6], seconds: f64) -> Reading {
    transducer(config, load).read(at(seconds))
}

#[test]
fn a_transducer_without_errors_reads_the_wrench() {
    assert_eq!(reading(TransducerConfig::default(), LOAD, 1.0), Reading { values: LOAD, saturated: 0 });
}

#[test]
fn every_channel_has_its_own_gain() {
    let gain = [1.01, 0.99, 1.02, 0.98, -1.0, 0.0];
    let values = [10.1, -19.8, 30.6, 0.98, 2.0, 0.0];
    let found = reading(TransducerConfig { gain, ..TransducerConfig::default() }, LOAD, 0.0).values;
    assert!(found.iter().zip(values).all(|(found, value)| (found - value).abs() < 1e-12), "{found:?}");
}

#[test]
fn drift_follows_the_first_order_temperature_course() {
    let config = TransducerConfig {
        offset: [0.5; 6],
        drift: [0.1, 0.2, -0.3, 0.01, 0.02, 0.0],
        temperature: TemperatureCourse { start: 20.0, end: 40.0, time_constant: Duration::from_secs(600) },
        ..TransducerConfig::default()
    };
    let e = std::f64::consts::E;
    for (seconds, warmth) in [(0.0, 0.0), (600.0, 20.0 * (1.0 - 1.0 / e)), (1200.0, 20.0 * (1.0 - 1.0 / e / e))] {
        let transducer = transducer(config.clone(), [0.0; 6]);
        assert!((transducer.temperature(at(seconds)) - 20.0 - warmth).abs() < 1e-9, "after {seconds} s");
        let values = reading(config.clone(), [0.0; 6], seconds).values;
        for (value, drift) in values.into_iter().zip(config.drift) {
            assert!((value - 0.5 - drift * warmth).abs() < 1e-9, "after {seconds} s: {values:?}");
        }
    }
    assert!(
        (TemperatureCourse { time_constant: Duration::ZERO, ..config.temperature }.at(Duration::ZERO) - 40.0).abs()
            < 1e-12
    );
}

#[test]
fn a_reading_at_the_range_is_limited_and_marked() {
    let beyond = [130.1, -200.0, 399.9, 10.0, f64::NAN, f64::NEG_INFINITY];
    let limited = Reading { values: [130.0, -130.0, 399.9, 10.0, 10.0, -10.0], saturated: 0b11_1011 };
    assert_eq!(reading(TransducerConfig::default(), beyond, 0.0), limited);
}

#[test]
fn the_present_load_is_zero_after_the_bias_and_the_range_is_as_before() {
    let mut load = LOAD;
    let mut transducer = Transducer::new(
        TransducerConfig::default(),
        Instant::ZERO,
        course(move |now| {
            // The load along x grows by 10 N/s.
            load[0] = 10.0 + 10.0 * now.since(Instant::ZERO).as_secs_f64();
            load
        }),
    )
    .unwrap();
    transducer.set_bias(at(1.0));
    assert_eq!(transducer.read(at(1.0)).values, [0.0; 6]);
    assert_eq!(transducer.read(at(2.0)).values, [10.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    // The true reading is limited at 130 N, of which 20 N are the bias.
    assert_eq!(transducer.read(at(20.0)), Reading { values: [110.0, 0.0, 0.0, 0.0, 0.0, 0.0], saturated: 1 });
    transducer.clear_bias();
    assert_eq!(transducer.read(at(20.0)).values[0], 130.0);
}

#[test]
fn noise_is_white_and_has_its_deviation_in_every_channel() {
    const COUNT: usize = 20_000;
    let noise = [0.1, 0.2, 0.4, 0.01, 0.02, 0.0];
    let mut transducer = transducer(TransducerConfig { noise, seed: 11, ..TransducerConfig::default() }, LOAD);
    let drawn: Vec<[f64; 6]> = (0..COUNT).map(|_| transducer.read(Instant::ZERO).values).collect();
    let deviations = |channel: usize| drawn.iter().map(move |values| values[channel] - LOAD[channel]);
    let mean = |products: &mut dyn Iterator<Item = f64>| products.sum::<f64>() / COUNT as f64;
    // Five standard errors of a mean of this many samples.
    let within = 5.0 / (COUNT as f64).sqrt();
    for (channel, sigma) in noise.into_iter().enumerate().take(5) {
        let average = mean(&mut deviations(channel));
        let square = mean(&mut deviations(channel).map(|x| x * x));
        let next = mean(&mut deviations(channel).zip(deviations(channel).skip(1)).map(|(x, y)| x * y));
        let other = (channel + 1) % 5;
        let across = mean(&mut deviations(channel).zip(deviations(other)).map(|(x, y)| x * y));
        assert!(average.abs() < within * sigma, "mean of {channel}: {average}");
        assert!((square.sqrt() / sigma - 1.0).abs() < within, "deviation of {channel}: {}", square.sqrt());
        assert!(next.abs() < within * sigma * sigma, "successive samples of {channel}: {next}");
        assert!(across.abs() < within * sigma * noise[other], "{channel} and {other}: {across}");
    }
    assert!(deviations(5).all(|deviation| deviation == 0.0));
}

#[test]
fn the_same_seed_gives_the_same_readings_bit_for_bit() {
    let readings = |seed| {
        let config = TransducerConfig { noise: [0.3; 6], drift: [0.1; 6], seed, ..TransducerConfig::default() };
        let mut transducer = transducer(config, LOAD);
        let read = |index: u32| transducer.read(at(f64::from(index) * 1e-3)).values.map(f64::to_bits);
        (0..100).map(read).collect::<Vec<_>>()
    };
    assert_eq!(readings(5), readings(5));
    assert_ne!(readings(5), readings(6));
}

#[test]
fn counts_are_rounded_and_limited_to_their_type() {
    for (value, per_count, narrow, wide) in [
        (0.0, 0.1, 0, 0),
        (0.049, 0.1, 0, 0),
        (0.051, 0.1, 1, 1),
        (-0.051, 0.1, -1, -1),
        (3276.7, 0.1, 32_767, 32_767),
        (3276.8, 0.1, 32_767, 32_768),
        (-3276.9, 0.1, -32_768, -32_769),
        (1e12, 0.1, i16::MAX, i32::MAX),
        (-1e12, 0.1, i16::MIN, i32::MIN),
    ] {
        assert_eq!((counts_16(value, per_count), counts(value, per_count)), (narrow, wide), "{value}");
    }
}

#[test]
fn impossible_configurations_are_refused_with_their_channel() {
    let with = |at: usize, value: f64| {
        let mut values = [1.0; 6];
        values[at] = value;
        values
    };
    let base = TransducerConfig::default;
    let cases = [
        (TransducerConfig { gain: with(0, f64::NAN), ..base() }, "gain of channel Fx is NaN, it must be finite"),
        (
            TransducerConfig { offset: with(5, f64::INFINITY), ..base() },
            "offset of channel Tz is inf, it must be finite",
        ),
        (
            TransducerConfig { drift: with(1, f64::NAN), ..base() },
            "drift of channel Fy is NaN per K, it must be finite",
        ),
        (TransducerConfig { range: with(2, 0.0), ..base() }, "range of channel Fz is 0, it must be above 0 and finite"),
        (
            TransducerConfig { noise: with(3, -0.1), ..base() },
            "noise of channel Tx is -0.1, it must be 0 or above, and finite",
        ),
    ];
    let refusal = |config| Transducer::new(config, Instant::ZERO, constant(LOAD)).err().expect("it is impossible");
    for (config, message) in cases {
        assert_eq!(refusal(config).to_string(), message);
    }
    let temperature = TemperatureCourse { end: f64::INFINITY, ..TemperatureCourse::CONSTANT };
    assert_eq!(
        refusal(TransducerConfig { temperature, ..base() }),
        ForceSensorError::Temperature { start: 25.0, end: f64::INFINITY }
    );
    assert_eq!(Channel::ALL.map(|channel| channel.to_string()).concat(), "FxFyFzTxTyTz");
}
