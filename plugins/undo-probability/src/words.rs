//! Why an action is rejected, for a person.

use std::fmt::{self, Display, Formatter};

/// "6 of 10 such actions could be undone; 8 of 10 are required", where `probability` is below `required`.
pub struct TooFew {
    pub probability: f32,
    pub required: f32,
}

/// Of so many actions the sentence speaks: of the first that tells the two figures apart.
const SAMPLES: [u32; 3] = [10, 100, 1000];
const LARGEST_SAMPLE: u32 = SAMPLES[SAMPLES.len() - 1];

impl TooFew {
    /// How many of a sample could be undone, and how many must.
    fn counts(&self, sample: u32) -> [u32; 2] {
        [self.probability, self.required].map(|share| (f64::from(share) * f64::from(sample)).round() as u32)
    }

    /// Whether a sample of this size shows that too few could be undone, and says "none" or "all" only where that is meant.
    fn is_clear_of(&self, sample: u32) -> bool {
        let [possible, required] = self.counts(sample);
        let is_none = self.probability == 0.0;
        let is_all = self.required == 1.0;
        possible < required && (possible > 0 || is_none) && (required < sample || is_all)
    }
}

impl Display for TooFew {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        let clear = SAMPLES.into_iter().find(|sample| self.is_clear_of(*sample));
        let sample = clear.unwrap_or(LARGEST_SAMPLE);
        let [possible, required] = self.counts(sample);
        write!(formatter, "{possible} of {sample} such actions could be undone; ")?;
        match required {
            _ if possible == required => formatter.write_str("slightly more are required"),
            1 => write!(formatter, "1 of {sample} is required"),
            _ => write!(formatter, "{required} of {sample} are required"),
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    fn says(probability: f32, required: f32) -> String {
        TooFew { probability, required }.to_string()
    }

    #[test]
    fn a_rejection_is_told_in_the_coarsest_figures_that_differ() {
        for (probability, required, expected) in [
            (0.6, 0.8, "6 of 10 such actions could be undone; 8 of 10 are required"),
            (0.0, 0.5, "0 of 10 such actions could be undone; 5 of 10 are required"),
            (0.0, 0.1, "0 of 10 such actions could be undone; 1 of 10 is required"),
            (0.78, 0.81, "78 of 100 such actions could be undone; 81 of 100 are required"),
            (0.04, 0.8, "4 of 100 such actions could be undone; 80 of 100 are required"),
            (0.5, 0.97, "50 of 100 such actions could be undone; 97 of 100 are required"),
            (0.5, 1.0, "5 of 10 such actions could be undone; 10 of 10 are required"),
            (0.802, 0.804, "802 of 1000 such actions could be undone; 804 of 1000 are required"),
            (0.0001, 0.8, "0 of 1000 such actions could be undone; 800 of 1000 are required"),
            (0.8001, 0.8002, "800 of 1000 such actions could be undone; slightly more are required"),
        ] {
            assert_eq!(says(probability, required), expected, "{probability} {required}");
        }
    }

    /// The two figures that a sentence names; none for the second where it is "slightly more".
    fn figures(sentence: &str) -> (u32, Option<u32>) {
        let (possible, required) = sentence.split_once("; ").unwrap();
        let first = |words: &str| words.split(' ').next().unwrap().parse().ok();
        (first(possible).unwrap(), first(required))
    }

    #[test]
    fn the_figures_of_a_rejection_never_contradict_it() {
        let mut rng = Pcg64::seed_from_u64(0);
        for round in 0..100_000 {
            let required: f32 = match round % 3 {
                0 => rng.random_range(0.0..=1.0),
                1 => rng.random_range(0.0..0.01),
                _ => rng.random_range(0.99..=1.0),
            };
            let below = [required * rng.random_range(0.0..1.0), required * 0.999, required.next_down()];
            for probability in below.into_iter().filter(|probability| (0.0..required).contains(probability)) {
                let sentence = says(probability, required);
                if let (possible, Some(needed)) = figures(&sentence) {
                    assert!(possible < needed, "{probability} {required}: {sentence}");
                } else {
                    assert!(required - probability <= 0.001, "{probability} {required}: {sentence}");
                }
            }
        }
    }
}
