//! Seeded random numbers.

/// A small seeded generator of random numbers: SplitMix64 (Steele, Lea, Flood, OOPSLA 2014).
///
/// A Weyl sequence: the state increases by the odd 64-bit golden ratio and is hashed by two rounds of xor-shift and
/// multiply. The period is 2^64. The quality suffices for ripple and jitter, not for secrets.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Noise(u64);

impl Noise {
    /// The same seed gives the same numbers.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in -1 ≤ x < 1, in steps of 2^-52.
    pub fn symmetric(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (1.0 / (1_u64 << 52) as f64) - 1.0
    }

    /// Normally distributed with mean 0 and standard deviation 1, by the polar method (Marsaglia, Bray, SIAM Review 1964).
    pub fn normal(&mut self) -> f64 {
        loop {
            let (x, y) = (self.symmetric(), self.symmetric());
            let square = x * x + y * y;
            if 0.0 < square && square < 1.0 {
                return x * (-2.0 * square.ln() / square).sqrt();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Noise;

    #[test]
    fn bits_are_the_published_sequence() {
        let mut noise = Noise::new(1_234_567);
        let bits = [0; 3].map(|_: u64| noise.bits());
        assert_eq!(bits, [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423]);
    }

    #[test]
    fn symmetric_numbers_fill_their_interval_evenly() {
        let mut noise = Noise::new(7);
        let drawn: Vec<f64> = (0..100_000).map(|_| noise.symmetric()).collect();
        let mean = drawn.iter().sum::<f64>() / drawn.len() as f64;
        let square = drawn.iter().map(|x| x * x).sum::<f64>() / drawn.len() as f64;
        assert!(drawn.iter().all(|x| (-1.0..1.0).contains(x)));
        assert!(mean.abs() < 0.01, "{mean}");
        assert!((square - 1.0 / 3.0).abs() < 0.01, "{square}");
    }

    #[test]
    fn normal_numbers_have_the_moments_and_tails_of_their_distribution() {
        let mut noise = Noise::new(7);
        let drawn: Vec<f64> = (0..100_000).map(|_| noise.normal()).collect();
        let moment = |power| drawn.iter().map(|x| x.powi(power)).sum::<f64>() / drawn.len() as f64;
        for (power, expected, within) in [(1, 0.0, 0.015), (2, 1.0, 0.02), (3, 0.0, 0.05), (4, 3.0, 0.15)] {
            assert!((moment(power) - expected).abs() < within, "moment {power}: {}", moment(power));
        }
        let beyond = |limit: f64| drawn.iter().filter(|x| x.abs() > limit).count() as f64 / drawn.len() as f64;
        assert!((beyond(1.0) - 0.3173).abs() < 0.008, "{}", beyond(1.0));
        assert!((beyond(3.0) - 0.0027).abs() < 0.0009, "{}", beyond(3.0));
    }
}
