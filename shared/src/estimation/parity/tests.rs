//! The properties of the parity space, for sensors of every size that there is.

extern crate std;

use std::vec::Vec;

use super::{GageNeeded, LARGEST_NOISE_GROWTH, ParitySpace, dot};

/// Rounding of single precision.
const EPSILON: f32 = f32::EPSILON;

/// Counts from zero to the end of the converter's range.
const FULL_SCALE: f32 = 8_388_608.0;

/// Numbers between −1 and 1, always the same.
fn numbers(seed: u32) -> impl Iterator<Item = f32> {
    let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(12_345);
    core::iter::repeat_with(move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / 8_388_608.0 - 1.0
    })
}

/// A calibration matrix of random rows, the last one in a unit of its own.
fn matrix<const GAGES: usize>(components: usize, seed: u32) -> Vec<[f32; GAGES]> {
    let mut numbers = numbers(seed);
    let mut rows: Vec<[f32; GAGES]> = (0..components)
        .map(|_| core::array::from_fn(|_| 1e-6 * numbers.next().unwrap_or_default()))
        .collect();
    for element in rows.last_mut().into_iter().flatten() {
        *element *= 0.01;
    }
    rows
}

/// Every size, from 2 components up and from as many gages as components.
fn every_size(check: impl Fn(usize, u32) + Copy, gages: usize) {
    for components in 2..=gages.min(6) {
        for seed in 0..20 {
            check(components, seed);
        }
    }
}

fn check_space<const GAGES: usize>(components: usize, seed: u32) {
    let matrix = matrix::<GAGES>(components, seed);
    let space = ParitySpace::new(&matrix);
    assert_eq!(space.redundant(), GAGES - components);
    for (one, row) in space.basis().iter().enumerate() {
        for (other, column) in space.basis().iter().enumerate() {
            let expected = if one == other { 1.0 } else { 0.0 };
            assert!((dot(row, column) - expected).abs() < 4.0 * EPSILON * GAGES as f32);
        }
        for load in &matrix {
            let length = dot(load, load).sqrt();
            // The signal of a load is along rows of C: at full scale this share of it is two counts.
            assert!(dot(row, load).abs() / length < 2.0 / FULL_SCALE, "{components} of {GAGES}, seed {seed}");
        }
    }
    let shares: f32 = (0..GAGES).map(|gage| space.share(gage)).sum();
    assert!((shares - (GAGES - components) as f32).abs() < 1e-5, "the trace of a projector is its rank");
}

#[test]
fn the_basis_is_orthonormal_and_no_load_shows_in_it() {
    every_size(check_space::<2>, 2);
    every_size(check_space::<4>, 4);
    every_size(check_space::<6>, 6);
    every_size(check_space::<8>, 8);
    every_size(check_space::<12>, 12);
}

/// C of any matrix is a left inverse of the shape Sᵀ whose rows are those of C, turned: CSᵀ = I. Rather than S, loads that C
/// makes: every signal along the rows of C must give the same wrench with and without the gage.
fn check_without<const GAGES: usize>(components: usize, seed: u32) {
    let whole = matrix::<GAGES>(components, seed);
    let space = ParitySpace::new(&whole);
    for gage in 0..GAGES {
        let mut reduced = whole.clone();
        let Ok(less) = space.without(gage, &mut reduced) else {
            assert_eq!(reduced, whole, "a refusal changes nothing");
            continue;
        };
        assert_eq!(less.redundant(), space.redundant() - 1);
        assert!(less.share(gage) == 0.0 && reduced.iter().all(|row| row[gage] == 0.0));
        for (row, other) in reduced.iter().zip(&whole) {
            let growth = (dot(row, row) / dot(other, other)).sqrt();
            let predicted =
                (1.0 + other[gage] * other[gage] / (space.share(gage) * dot(other, other))).sqrt();
            assert!((growth / predicted - 1.0).abs() < 1e-3 && growth <= 1.001 * LARGEST_NOISE_GROWTH);
            for load in &whole {
                let wrench = |row: &[f32; GAGES]| {
                    row.iter().zip(load).map(|(c, s)| f64::from(*c) * f64::from(*s)).sum::<f64>()
                };
                let scale = f64::from((dot(other, other) * dot(load, load)).sqrt());
                // Rounding grows as noise does, and once more where the share is small.
                assert!((wrench(row) - wrench(other)).abs() < 2e-5 * f64::from(growth * growth) * scale);
            }
        }
        for (one, row) in less.basis().iter().enumerate() {
            for (other, column) in less.basis().iter().enumerate() {
                let expected = if one == other { 1.0 } else { 0.0 };
                assert!((dot(row, column) - expected).abs() < 1e-5);
            }
            for load in &reduced {
                assert!(dot(row, load).abs() / dot(load, load).sqrt() < 1e-4);
            }
        }
    }
}

#[test]
fn without_a_gage_loads_are_the_same_and_noise_is_what_it_must_be() {
    every_size(check_without::<4>, 4);
    every_size(check_without::<6>, 6);
    every_size(check_without::<8>, 8);
    every_size(check_without::<12>, 12);
}

#[test]
fn one_gage_shows_along_its_column_alone() {
    let space = ParitySpace::new(&matrix::<8>(3, 7));
    for gage in 0..8 {
        let mut off = [0.0; 8];
        off[gage] = 1000.0;
        let parity = space.parity(&off);
        for (component, row) in parity.iter().zip(space.basis()) {
            assert!((component - 1000.0 * row[gage]).abs() < 1e-3);
        }
        assert!((dot(&parity, &parity) - 1e6 * space.share(gage)).abs() < 10.0);
    }
}

#[test]
fn with_no_redundant_gage_every_gage_is_needed() {
    let mut matrix = matrix::<6>(6, 3);
    let space = ParitySpace::new(&matrix);
    assert_eq!((space.redundant(), space.watched()), (0, 0));
    for gage in 0..7 {
        assert_eq!(space.without(gage, &mut matrix), Err(GageNeeded));
    }
}

/// Gage 2 alone feels the second component.
#[test]
fn a_gage_that_nothing_replaces_is_needed_and_unwatched() {
    let mut matrix = [[1e-6, 1e-6, 0.0, 1e-6], [0.0, 0.0, 1e-6, 0.0]];
    let space = ParitySpace::new(&matrix);
    assert_eq!((space.redundant(), space.watched()), (2, 0b1011));
    assert_eq!(space.without(2, &mut matrix), Err(GageNeeded));
    assert!(space.without(0, &mut matrix).is_ok());
}

#[test]
fn rows_that_are_no_calibration_leave_nothing_to_watch() {
    let row = [1e-6, 2e-6, 3e-6, 4e-6];
    assert_eq!(ParitySpace::new(&[row, row]).redundant(), 0);
    assert_eq!(ParitySpace::new(&[row, [0.0; 4]]).redundant(), 0);
    assert_eq!(ParitySpace::new(&[row, [f32::NAN; 4]]).redundant(), 0);
    assert_eq!(ParitySpace::new(&[row; 5]).redundant(), 0);
}
