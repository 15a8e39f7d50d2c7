//! Parity: what the codes of p gages say beyond the m components of a wrench, and what follows where that is not nothing
//! (design § 8).
//!
//! # The space
//!
//! The signal of any load lies in the m rows of S. For C = (Sᵀ)⁺ (eq. 5) those are the rows of C, too, so that the calibration
//! matrix alone determines the p − m directions in which no load shows. Their orthonormal basis B (q × p, q = p − m) gives
//! I − SᵀC = BᵀB, and the **parity** π = B(z − b) is zero whatever the load, but for noise. Orthonormal rows keep white noise white
//! and of the same variance, and make ‖π‖ = ‖(I − SᵀC)(z − b)‖.
//!
//! B comes from modified Gram–Schmidt, twice over, first on the rows of C, each brought to length one so that their units do not
//! matter, then on the gages' own directions, the one farthest from all before first. It is made in single precision, of a matrix
//! that comes in single precision: of a load a share of a few 2⁻²⁴ shows, a count or two at full scale.
//!
//! # One gage that is off
//!
//! A gage k that is off by δ gives π = δ·b_k, with b_k the k-th column of B. Its length squared is the gage's **share**
//! P_kk = ‖b_k‖²: zero for a gage that the wrench cannot do without, one for a gage that adds nothing to the others. Which gage it is
//! shows in the direction alone, and where two columns are parallel (opposite gages of a beam, say), nobody can tell.
//!
//! # Without a gage
//!
//! Leaving gage k out is the least-squares wrench of the others. With C_k, P_k the k-th columns it is
//!
//! C' = C − C_k P_kᵀ / P_kk,
//!
//! which has a zero column k, still gives C'Sᵀ = I, and noise whose variance in component i has grown from ‖C_i‖² to
//! ‖C_i‖² + C_ik²/P_kk, because rows of C and of P are perpendicular. The parity space loses the direction b_k.

use libm::sqrtf;

/// The least length, among directions of length one, of what a vector has beyond them.
const LEAST_REST: f32 = 1e-3;

/// The largest factor by which the noise of a component may grow when a gage is left out.
pub const LARGEST_NOISE_GROWTH: f32 = 10.0;

/// The least share of a gage whose faults count as visible: a tenth of it shows.
pub const LEAST_SHARE: f32 = 0.01;

/// The parity space of a calibration of `GAGES` gages.
#[derive(Clone, Debug, PartialEq)]
pub struct ParitySpace<const GAGES: usize> {
    /// B: q orthonormal rows; those beyond q are zero.
    basis: [[f32; GAGES]; GAGES],
    /// q.
    redundant: usize,
}

/// A gage without which there is no wrench, or none worth having.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GageNeeded;

impl<const GAGES: usize> ParitySpace<GAGES> {
    /// The space of this calibration matrix (m × p, a row a component). Empty at p = m, and where the rows are not independent, as
    /// those of a calibration are.
    pub fn new(matrix: &[[f32; GAGES]]) -> Self {
        let empty = Self { basis: [[0.0; GAGES]; GAGES], redundant: 0 };
        // The rows of C, then those of B: a basis of everything.
        let mut rows = [[0.0; GAGES]; GAGES];
        for (count, row) in matrix.iter().enumerate() {
            let Some((before, place)) = split_at_row(&mut rows, count) else { return empty };
            let Some(unit) = rest(&scaled(row), before) else { return empty };
            *place = unit;
        }
        for count in matrix.len()..GAGES {
            let Some((before, place)) = split_at_row(&mut rows, count) else { return empty };
            // The gage with the least share in what there is has the most of what is missing.
            let taken = |gage: usize| before.iter().map(|row| row[gage] * row[gage]).sum::<f32>();
            let farthest = (0..GAGES).min_by(|&a, &b| taken(a).total_cmp(&taken(b))).unwrap_or(0);
            let mut direction = [0.0; GAGES];
            direction[farthest] = 1.0;
            let Some(unit) = rest(&direction, before) else { return empty };
            *place = unit;
        }
        let mut space = empty;
        for (row, found) in space.basis.iter_mut().zip(rows.iter().skip(matrix.len())) {
            *row = *found;
            space.redundant += 1;
        }
        space
    }

    /// q, the redundant directions.
    pub const fn redundant(&self) -> usize {
        self.redundant
    }

    /// B, q rows.
    pub fn basis(&self) -> &[[f32; GAGES]] {
        self.basis.split_at_checked(self.redundant).map_or(&[], |(rows, _)| rows)
    }

    /// B in pairs of rows, as few as hold all q; an odd one comes with a row of zeros.
    pub fn pairs(&self) -> &[[[f32; GAGES]; 2]] {
        let (pairs, _) = self.basis.as_chunks::<2>();
        pairs.split_at_checked(self.redundant.div_ceil(2)).map_or(pairs, |(used, _)| used)
    }

    /// π of a signal, counts; elements beyond q are zero.
    pub fn parity(&self, signal: &[f32; GAGES]) -> [f32; GAGES] {
        let mut parity = [0.0; GAGES];
        for (component, row) in parity.iter_mut().zip(self.basis()) {
            for gage in 0..GAGES {
                *component += row[gage] * signal[gage];
            }
        }
        parity
    }

    /// P_kk: how much of the square of what this gage is off by shows, 0 to 1.
    pub fn share(&self, gage: usize) -> f32 {
        self.basis().iter().filter_map(|row| row.get(gage)).map(|element| element * element).sum()
    }

    /// The gages whose faults show: bit k for gage k.
    pub fn watched(&self) -> u16 {
        (0..GAGES).fold(0, |mask, gage| mask | u16::from(self.share(gage) >= LEAST_SHARE) << gage)
    }

    /// The matrix and the space without a gage.
    ///
    /// # Errors
    ///
    /// [`GageNeeded`] where the noise of a component would grow more than [`LARGEST_NOISE_GROWTH`]-fold.
    pub fn without(&self, gage: usize, matrix: &mut [[f32; GAGES]]) -> Result<Self, GageNeeded> {
        let share = self.share(gage);
        if gage >= GAGES || share <= LEAST_REST * LEAST_REST {
            return Err(GageNeeded);
        }
        let growth = LARGEST_NOISE_GROWTH * LARGEST_NOISE_GROWTH - 1.0;
        if matrix.iter().any(|row| row[gage] * row[gage] > growth * share * dot(row, row)) {
            return Err(GageNeeded);
        }
        let mut projected = [0.0; GAGES];
        for row in self.basis() {
            for other in 0..GAGES {
                projected[other] += row[gage] * row[other];
            }
        }
        for row in matrix.iter_mut() {
            let factor = row[gage] / share;
            for other in 0..GAGES {
                row[other] -= factor * projected[other];
            }
            row[gage] = 0.0;
        }
        Ok(self.less(gage, share))
    }

    /// The space without the direction of one gage: a reflection turns the basis until that direction is its first row, which is
    /// left out. No other row then has anything of the gage.
    fn less(&self, gage: usize, share: f32) -> Self {
        let mut reduced = Self { basis: [[0.0; GAGES]; GAGES], redundant: self.redundant.saturating_sub(1) };
        let Some((first, others)) = self.basis().split_first() else { return reduced };
        // Householder's reflection takes b_k to −sign(b_k0)·‖b_k‖ along the first axis: with v = b_k + sign(b_k0)·‖b_k‖ along it,
        // row i becomes row i − v_i·w, where w = 2·(vᵀB)/‖v‖².
        let length = sqrtf(share);
        let head = first[gage] + if first[gage] < 0.0 { -length } else { length };
        let squared = share - first[gage] * first[gage] + head * head;
        let mut turned = first.map(|element| head * element);
        for row in others {
            for other in 0..GAGES {
                turned[other] += row[gage] * row[other];
            }
        }
        for (place, row) in reduced.basis.iter_mut().zip(others) {
            let factor = 2.0 * row[gage] / squared;
            *place = core::array::from_fn(|other| row[other] - factor * turned[other]);
            place[gage] = 0.0;
        }
        reduced
    }
}

/// The rows before this one, and this one.
fn split_at_row<const GAGES: usize>(
    rows: &mut [[f32; GAGES]; GAGES],
    count: usize,
) -> Option<(&[[f32; GAGES]], &mut [f32; GAGES])> {
    let (before, from) = rows.split_at_mut_checked(count)?;
    Some((before, from.first_mut()?))
}

/// What a vector of about length one has beyond orthonormal rows, brought to length one; `None` where that is nothing. The second
/// pass takes away what rounding has left of the first.
fn rest<const GAGES: usize>(vector: &[f32; GAGES], rows: &[[f32; GAGES]]) -> Option<[f32; GAGES]> {
    let mut rest = *vector;
    for _ in 0..2 {
        for row in rows {
            let along = dot(&rest, row);
            for gage in 0..GAGES {
                rest[gage] -= along * row[gage];
            }
        }
        // Whether anything is left is to be asked before it is stretched.
        let length = sqrtf(dot(&rest, &rest));
        if length.is_nan() || length < LEAST_REST {
            return None;
        }
        rest = rest.map(|element| element / length);
    }
    Some(rest)
}

/// The vector over its largest element, whose square single precision may not hold, and then over its length.
fn scaled<const GAGES: usize>(vector: &[f32; GAGES]) -> [f32; GAGES] {
    let largest = vector.iter().fold(0.0_f32, |largest, element| largest.max(element.abs()));
    let vector = vector.map(|element| element / largest);
    let length = sqrtf(dot(&vector, &vector));
    vector.map(|element| element / length)
}

fn dot<const GAGES: usize>(one: &[f32; GAGES], other: &[f32; GAGES]) -> f32 {
    let mut sum = 0.0;
    for gage in 0..GAGES {
        sum += one[gage] * other[gage];
    }
    sum
}

#[cfg(test)]
mod tests;
