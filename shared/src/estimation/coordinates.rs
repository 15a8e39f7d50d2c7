//! Vectors, matrices and symmetric tensors in the coordinates of the motion.
//!
//! How many coordinates there are, the rank r of the trial, is known at run time, and there is room for [`MAX_RANK`] of them. **What lies
//! beyond the rank is zero**, always: so sums, products, norms and moments take no notice of the rank. Only what is to be
//! inverted does, and has ones there on its diagonal meanwhile ([`cholesky`]).
//!
//! A symmetric tensor is stored without repetition. Let s of an element's indices be other than the first axis, and t of those
//! other than the second: it stands at s(s + 1)/2 + t, whatever the order of the indices, and in degree n there are
//! (n + 1)(n + 2)/2 of them. One more index of axis 0, 1 or 2 takes (s, t) to (s, t), (s + 1, t) or (s + 1, t + 1).

use core::ops::{AddAssign, Index, IndexMut};

use nalgebra::{Cholesky, Const, RealField, SMatrix, SVector};

use crate::units::{MAX_RANK, Rank};

/// One number for each coordinate of the motion.
pub type MotionVector = SVector<f64, MAX_RANK>;

/// From coordinates of the motion to coordinates of the motion.
pub type MotionMatrix = SMatrix<f64, MAX_RANK, MAX_RANK>;

/// A symmetric tensor: its different elements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tensor<Number, const DEGREE: usize, const ELEMENTS: usize>([Number; ELEMENTS]);

/// A symmetric tensor of degree two; in double precision, [`MotionMatrix`] is used.
pub type Second<Number> = Tensor<Number, 2, 6>;

/// A symmetric tensor of degree three.
pub type Third<Number> = Tensor<Number, 3, 10>;

/// A symmetric tensor of degree four.
pub type Fourth<Number> = Tensor<Number, 4, 15>;

/// A vector of these elements.
pub fn vector(rank: Rank, element: impl Fn(usize) -> f64) -> MotionVector {
    let mut vector = MotionVector::zeros();
    for axis in rank.axes() {
        vector[axis] = element(axis);
    }
    vector
}

/// The identity.
pub fn identity(rank: Rank) -> MotionMatrix {
    MotionMatrix::from_diagonal(&vector(rank, |_| 1.0))
}

/// AB.
#[inline(never)]
pub(super) fn product(left: &MotionMatrix, right: &MotionMatrix) -> MotionMatrix {
    left * right
}

/// The Cholesky factor of a positive definite matrix; beyond the rank that of the identity, so that it may be divided by.
#[inline(never)]
pub fn cholesky(matrix: &MotionMatrix, rank: Rank) -> Option<Cholesky<f64, Const<MAX_RANK>>> {
    let mut matrix = *matrix;
    for axis in rank.count()..MAX_RANK {
        matrix[(axis, axis)] = 1.0;
    }
    Cholesky::new(matrix)
}

/// B M Bᵀ: a covariance of y as one of B y.
#[inline(never)]
pub(super) fn carried(by: &MotionMatrix, matrix: &MotionMatrix) -> MotionMatrix {
    product(&product(by, matrix), &by.transpose())
}

/// Where an element with these indices stands.
pub(super) const fn place(indices: &[usize]) -> usize {
    let (mut beyond_first, mut beyond_second, mut index) = (0, 0, 0);
    while index < indices.len() {
        if indices[index] > 0 {
            beyond_first += 1;
        }
        if indices[index] > 1 {
            beyond_second += 1;
        }
        index += 1;
    }
    beyond_first * (beyond_first + 1) / 2 + beyond_second
}

impl<const DEGREE: usize, const ELEMENTS: usize> Tensor<f64, DEGREE, ELEMENTS> {
    /// Zero.
    pub const ZERO: Self = Self([0.0; ELEMENTS]);

    /// The same in single precision.
    #[expect(clippy::cast_possible_truncation, reason = "single precision is asked for")]
    pub fn rounded(&self) -> Tensor<f32, DEGREE, ELEMENTS> {
        Tensor(self.0.map(|element| element as f32))
    }

    /// The tensor times a number.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self(self.0.map(|element| element * factor))
    }
}

impl<const DEGREE: usize, const ELEMENTS: usize> AddAssign<&Self> for Tensor<f64, DEGREE, ELEMENTS> {
    fn add_assign(&mut self, other: &Self) {
        for (mine, theirs) in self.0.iter_mut().zip(&other.0) {
            *mine += theirs;
        }
    }
}

impl<Number, const DEGREE: usize, const ELEMENTS: usize> Index<[usize; DEGREE]>
    for Tensor<Number, DEGREE, ELEMENTS>
{
    type Output = Number;

    fn index(&self, indices: [usize; DEGREE]) -> &Number {
        &self.0[place(&indices)]
    }
}

impl<Number, const DEGREE: usize, const ELEMENTS: usize> IndexMut<[usize; DEGREE]>
    for Tensor<Number, DEGREE, ELEMENTS>
{
    fn index_mut(&mut self, indices: [usize; DEGREE]) -> &mut Number {
        &mut self.0[place(&indices)]
    }
}

impl<Number: RealField + Copy> Fourth<Number> {
    /// Σ_d T_abcd v_d.
    pub fn along(&self, vector: &SVector<Number, MAX_RANK>) -> Third<Number> {
        let mut contracted = Tensor([Number::zero(); 10]);
        contract(&self.0, vector, &mut contracted.0);
        contracted
    }
}

impl<Number: RealField + Copy> Third<Number> {
    /// Σ_c T_abc v_c.
    pub fn along(&self, vector: &SVector<Number, MAX_RANK>) -> Second<Number> {
        let mut contracted = Tensor([Number::zero(); 6]);
        contract(&self.0, vector, &mut contracted.0);
        contracted
    }
}

impl<Number: RealField + Copy> Second<Number> {
    /// Σ_b T_ab v_b.
    pub fn along(&self, vector: &SVector<Number, MAX_RANK>) -> SVector<Number, MAX_RANK> {
        let mut contracted = SVector::<Number, MAX_RANK>::zeros();
        contract(&self.0, vector, contracted.as_mut_slice());
        contracted
    }
}

/// Takes one index out of a tensor, along a vector.
#[inline(never)]
fn contract<Number: RealField + Copy>(
    tensor: &[Number],
    along: &SVector<Number, MAX_RANK>,
    contracted: &mut [Number],
) {
    let mut place = 0;
    for beyond_first in 0.. {
        for _ in 0..=beyond_first {
            let Some(element) = contracted.get_mut(place) else { return };
            let elsewhere = place + beyond_first;
            *element = along[0] * tensor[place]
                + along[1] * tensor[elsewhere + 1]
                + along[2] * tensor[elsewhere + 2];
            place += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::{Fourth, MotionVector, Tensor, place};

    #[test]
    fn every_element_has_its_place() {
        let mut fourth = Fourth::<f64>::ZERO;
        let mut expected = 0;
        for s in 0..=4 {
            for t in 0..=s {
                let mut indices = [0; 4];
                indices[..s].fill(1);
                indices[..t].fill(2);
                assert_eq!(place(&indices), expected);
                fourth[indices] = 1.0;
                indices.reverse();
                assert_eq!(fourth[indices], 1.0);
                expected += 1;
            }
        }
        assert_eq!(fourth, Tensor([1.0; 15]));
    }

    /// The tensor of all products of a vector with itself, along other vectors.
    #[test]
    fn contraction_takes_out_an_index() {
        let m = MotionVector::new(2.0, -3.0, 5.0);
        let mut fourth = Fourth::<f64>::ZERO;
        for a in 0..3 {
            for b in a..3 {
                for c in b..3 {
                    for d in c..3 {
                        fourth[[a, b, c, d]] = m[a] * m[b] * m[c] * m[d];
                    }
                }
            }
        }
        let along = [Vector3::new(1.0, 0.0, 0.0), Vector3::new(0.0, 1.0, 2.0), Vector3::new(4.0, -1.0, 1.0)];
        let third = fourth.along(&along[0]);
        assert_eq!(third[[2, 1, 2]], m[2] * m[1] * m[2] * m.dot(&along[0]));
        let second = third.along(&along[1]);
        assert_eq!(second[[0, 2]], m[0] * m[2] * m.dot(&along[0]) * m.dot(&along[1]));
        let factors: f64 = along.iter().map(|vector| m.dot(vector)).product();
        assert_eq!(second.along(&along[2]), m * factors);
    }
}
