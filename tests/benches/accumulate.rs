//! How fast and in how much memory the host sums up a long trial: `tests/speed` sets it beside numpy's SVD.
//!
//! Prints the seconds for 10⁶ samples of 8 gages, and the size of all that is kept of them.

use std::time::Instant;

use ftcal_shared::estimation::moments::{Moments, higher_moment_count};
use ftcal_shared::units::AdcCode;
use ftcal_tests::random;
use rand::RngExt;

const GAGES: usize = 8;
const HIGHER: usize = higher_moment_count(GAGES);
const SAMPLES: usize = 1_000_000;

/// Of several runs the fastest: whatever else the machine does only adds to it.
const RUNS: usize = 5;

fn main() {
    let mut rng = random(1);
    let codes: Vec<[AdcCode; GAGES]> = (0..SAMPLES)
        .map(|_| core::array::from_fn(|_| AdcCode::saturating(rng.random_range(-1_000_000..1_000_000))))
        .collect();
    let mut fastest = f64::INFINITY;
    for _ in 0..RUNS {
        let begin = Instant::now();
        let mut moments = Moments::<GAGES, HIGHER>::new([AdcCode::ZERO; GAGES]);
        for sample in &codes {
            moments.push(sample).expect("fewer samples than the accumulator takes");
        }
        moments.settle();
        fastest = fastest.min(begin.elapsed().as_secs_f64());
        assert_eq!(moments.count(), SAMPLES as u64);
    }
    println!("accumulate_seconds {fastest:.4}");
    println!("accumulate_bytes {}", size_of::<Moments<GAGES, HIGHER>>());
}
