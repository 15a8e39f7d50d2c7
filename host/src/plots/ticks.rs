//! Where an axis has its ticks, and with how many decimals they are labelled.
//!
//! The step is 1, 2 or 5 times a power of ten, the smallest that gives at most the number of ticks asked for; the
//! decimals are those of the step, so that all labels of an axis are written alike.
//!
//! Domain: ranges inside about ±1e6 that are no narrower than a thousandth of their largest value and of the unit, which
//! [`padded_range`] sees to. There, a label has seven digits at most.

use std::ops::Range;

/// A tick may lie this fraction of a step outside its range: six steps of 0.2 are a little more than 1.2.
const EDGE: f64 = 1e-6;

/// Ticks of one axis.
#[derive(Debug, Clone)]
pub(super) struct Ticks {
    /// Ascending; all inside the range asked for, its ends included.
    pub(super) positions: Vec<f64>,
    decimals: usize,
}

impl Ticks {
    /// At most `at_most` intervals between the ticks over `range`.
    pub(super) fn over(range: &Range<f64>, at_most: u32) -> Self {
        let (step, decimals) = step_for((range.end - range.start) / f64::from(at_most));
        let mut positions = Vec::new();
        let mut number = (range.start / step - EDGE).ceil();
        while number <= range.end / step + EDGE {
            // Adding zero turns the -0 that `ceil` gives just below zero into 0, which is what a label shall read.
            positions.push(number * step + 0.0);
            number += 1.0;
        }
        Self { positions, decimals }
    }

    /// The whole numbers from 1 to `last`, or every second, fifth, tenth... of them when they are more than `at_most`.
    pub(super) fn counting(last: usize, at_most: u32) -> Self {
        let last = last as f64;
        let (step, decimals) = step_for((last / f64::from(at_most)).max(1.0));
        let mut positions = Vec::new();
        let mut number = step;
        while number <= last {
            positions.push(number);
            number += step;
        }
        Self { positions, decimals }
    }

    /// The label of the tick at `value`, with a typographic minus sign.
    pub(super) fn label(&self, value: f64) -> String {
        format!("{value:.*}", self.decimals).replace('-', "−")
    }
}

/// The smallest 1, 2 or 5 times a power of ten that is not below `least`, and its decimals.
fn step_for(least: f64) -> (f64, usize) {
    for exponent in -6..=7_i32 {
        for multiple in [1.0, 2.0, 5.0] {
            let step = multiple * 10.0_f64.powi(exponent);
            if step >= least {
                return (step, usize::try_from(-exponent).unwrap_or(0));
            }
        }
    }
    (least, 0)
}

/// The range of all `values` with a margin of 8 % on either side, and never empty: it reaches a thousandth of the largest
/// value, and of the axis' unit, beyond them.
pub(super) fn padded_range(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = values
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    let margin = (0.08 * (high - low)).max(1e-3 * low.abs().max(high.abs())).max(1e-3);
    low - margin..high + margin
}

#[cfg(test)]
mod tests {
    use super::{EDGE, Ticks, padded_range};

    #[test]
    fn ticks_lie_inside_ascend_evenly_and_are_not_too_many() {
        for range in [0.0..1.2, -1.3..1.3, 25.1..25.4, 999.0..1001.0, 0.0..2e6, -1e-3..1e-3] {
            let ticks = Ticks::over(&range, 6);
            assert!((2..=7).contains(&ticks.positions.len()), "{range:?}: {ticks:?}");
            let step = ticks.positions[1] - ticks.positions[0];
            let inside = range.start - EDGE * step..=range.end + EDGE * step;
            assert!(ticks.positions.iter().all(|tick| inside.contains(tick)));
            for pair in ticks.positions.windows(2) {
                assert!((pair[1] - pair[0] - step).abs() < 1e-9 * step.max(pair[1].abs()));
            }
        }
    }

    #[test]
    fn the_end_of_a_range_has_its_tick() {
        // In floating point 6 * 0.2 > 1.2 and 3 * 0.1 > 0.3.
        for end in [1.2, 0.3] {
            let ticks = Ticks::over(&(-end..end), 12);
            for edge in [ticks.positions.first(), ticks.positions.last()] {
                assert!((edge.unwrap().abs() - end).abs() < 1e-12, "{ticks:?}");
            }
        }
    }

    #[test]
    fn a_label_reads_as_its_tick() {
        for range in [0.0..1.2, -1.3..1.3, 25.1..25.4, 0.0..2e6] {
            let ticks = Ticks::over(&range, 6);
            for tick in &ticks.positions {
                let label = ticks.label(*tick);
                let read: f64 = label.replace('−', "-").parse().unwrap();
                assert!((read - tick).abs() <= 1e-12 * tick.abs().max(1.0));
                assert!(read != 0.0 || !label.starts_with('−'), "{label}");
            }
        }
    }

    #[test]
    fn counting_names_every_number_or_evenly_chosen_ones() {
        assert_eq!(Ticks::counting(10, 12).positions, (1..=10).map(f64::from).collect::<Vec<_>>());
        assert_eq!(Ticks::counting(1, 12).positions, [1.0]);
        for last in 13..200 {
            let ticks = Ticks::counting(last, 12);
            assert!((2..=12).contains(&ticks.positions.len()), "{last}: {ticks:?}");
            assert!(ticks.positions.iter().all(|tick| tick.fract() == 0.0 && *tick <= last as f64));
        }
    }

    #[test]
    fn a_padded_range_holds_its_values_and_is_never_empty() {
        for values in [vec![0.0], vec![25.24, 25.24], vec![-1e6, 1e6], vec![1.0, 3.0]] {
            let range = padded_range(values.iter().copied());
            assert!(range.end > range.start);
            assert!(values.iter().all(|value| range.contains(value)));
        }
    }
}
