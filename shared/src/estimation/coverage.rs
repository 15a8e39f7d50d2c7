//! Coverage: how much of all directions the load has been through, how good the answer is by now, and which way to turn
//! the load next (design § 4). From the moments alone, so that a trial can be asked while it runs.
//!
//! * **Fraction.** Let d be the density of the load's directions relative to the uniform one. The fraction is 1/⟨d²⟩, the mean
//!   taken over the sphere or circle: a load that was equally often everywhere in a share A of all directions, and nowhere
//!   else, has d = 1/A there and the fraction A. Dwelling in a few directions lowers it, as it should: the six faces of a cube
//!   are 0.16, and leave the answer open. The density is known up to degree four, so that a single direction is not 0 but
//!   1/25 in space and 1/9 in the plane.
//! * **Worst relative uncertainty.** The largest predicted standard deviation of any gain, cross-talk or offset, relative to
//!   the load ([`TrialUncertainty::worst_relative`](super::uncertainty::TrialUncertainty::worst_relative)).
//! * **Weakest direction.** A sample with the load at m tells the more of the metric constraint, the less the constraint is
//!   known there: φ(m)ᵀ Ψ⁻¹ φ(m), with the information Ψ = ⟨φφᵀ⟩ per sample. Where one eigenvector of Ψ is weak this is
//!   that eigenvector's quadric, squared; unlike the eigenvector it does not depend on the frame, which is arbitrary. The
//!   direction asked for is that of the maximum over the directions of [`for_each_direction`], at most 30° apart.
//!
//! The trial's own frame means nothing to a person who turns the load, but the gages do: they are what is on the screen.
//! So a direction is named by the codes that it gives: the gage whose code depends most on the direction alone comes first, and
//! others follow until together they pin the direction down within 26°.

use nalgebra::{SMatrix, SVector};

use super::coordinates::{MotionVector, identity};
use super::directions::for_each_direction;
use super::quadric::{monomials, normal_matrix};
use super::shape::TrialSolution;
use super::square::invert;
use crate::refusal::Refusal;
use crate::units::MAX_RANK;

/// The cosine between the direction asked for and its projection on what the named gages see: 26°.
const PINNED_DOWN: f64 = 0.9;

/// The most gages that name one direction.
pub const MAX_TARGETS: usize = 3;

/// Where a trial stands.
#[derive(Clone, Debug)]
pub struct Coverage<const GAGES: usize> {
    /// Samples that took part.
    pub samples: u64,
    /// The share of all directions that the load has been through; see above.
    pub fraction: f64,
    /// The largest predicted standard deviation of a gain, cross-talk or offset, relative to the load.
    pub worst_relative_uncertainty: f64,
    /// Standard deviations of the bias, counts.
    pub bias_deviation_counts: SVector<f64, GAGES>,
    /// Standard deviations of the shape (r × p), counts per unit load, up to its orientation.
    pub shape_deviation_counts_per_load: SMatrix<f64, MAX_RANK, GAGES>,
    /// The direction in which the next samples tell most: a unit vector in the trial's own frame.
    pub weakest_direction: MotionVector,
    /// What the gages read there, the most telling one first.
    pub targets: heapless::Vec<GageTarget, MAX_TARGETS>,
}

/// What one gage reads with the load in a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GageTarget {
    /// The gage, counted from zero.
    pub gage: u8,
    /// Its code there, counts.
    pub counts: f64,
    /// Where that stands in the range that turning the load gives this gage: from −1, the lowest, to 1, the highest.
    pub position: f64,
}

/// What a solved trial has covered.
///
/// # Errors
///
/// [`Refusal::MotionDoesNotSpan`] where the directions do not determine the constraint.
#[inline(never)]
pub fn coverage<const GAGES: usize>(solution: &TrialSolution<GAGES>) -> Result<Coverage<GAGES>, Refusal> {
    let mut inverse = normal_matrix(&solution.directions.higher, solution.rank);
    let undetermined = Refusal::MotionDoesNotSpan { relative_uncertainty: f32::INFINITY, need: 1.0 };
    invert(&mut inverse).map_err(|_| undetermined)?;
    let mut weakest = (0.0, MotionVector::zeros());
    for_each_direction(solution.rank, |m, _| {
        let phi = monomials(&m);
        let unknown = phi.dot(&(inverse * phi));
        if unknown > weakest.0 {
            weakest = (unknown, m);
        }
    });
    let (_, weakest_direction) = weakest;
    let TrialSolution { uncertainty, shape_counts_per_load: shape, redundant_noise, .. } = solution;
    Ok(Coverage {
        bias_deviation_counts: uncertainty.bias_deviation(shape, redundant_noise),
        shape_deviation_counts_per_load: uncertainty.turned_shape_deviation(
            shape,
            redundant_noise,
            &identity(solution.rank),
        ),
        samples: solution.samples,
        fraction: 1.0 / solution.directions.concentration().max(1.0),
        worst_relative_uncertainty: uncertainty.worst_relative(),
        targets: targets(solution, &weakest_direction),
        weakest_direction,
    })
}

/// How far a trial is, from 0 to 1, where its uncertainty is now `predicted` and `asked` is wanted: uncertainty falls with the
/// square root of the time, if the load keeps turning as it did.
pub fn progress(predicted: f64, asked: f64) -> f64 {
    let ratio = asked / predicted;
    if ratio.is_finite() { (ratio * ratio).clamp(0.0, 1.0) } else { f64::from(u8::from(predicted == 0.0)) }
}

/// Names a direction by the gages that depend on it most: each time the gage that sees most of what the ones before leave
/// open.
fn targets<const GAGES: usize>(
    solution: &TrialSolution<GAGES>,
    direction: &MotionVector,
) -> heapless::Vec<GageTarget, MAX_TARGETS> {
    let sensitivity = |gage: usize| solution.shape_counts_per_load.column(gage).into_owned();
    let open_after_all = 1.0 - PINNED_DOWN * PINNED_DOWN;
    let mut targets = heapless::Vec::new();
    let mut open = *direction;
    let mut seen: heapless::Vec<MotionVector, MAX_TARGETS> = heapless::Vec::new();
    while open.norm_squared() > open_after_all && seen.len() < solution.rank.count() {
        let telling = |gage: usize| sensitivity(gage).normalize().dot(&open).abs();
        let Some(gage) = (0..GAGES).max_by(|&a, &b| telling(a).total_cmp(&telling(b))) else { break };
        let along = sensitivity(gage);
        let fresh = seen.iter().fold(along, |fresh, axis| fresh - axis * axis.dot(&along));
        let Some(axis) = fresh.try_normalize(f64::EPSILON * along.norm()) else { break };
        open -= axis * axis.dot(&open);
        #[expect(clippy::cast_possible_truncation, reason = "at most 12 gages")]
        let target = GageTarget {
            gage: gage as u8,
            counts: solution.bias_counts[gage] + along.dot(direction),
            position: along.normalize().dot(direction),
        };
        // Rank is three at most, and so is the room.
        if targets.push(target).is_err() || seen.push(axis).is_err() {
            break;
        }
    }
    targets
}
