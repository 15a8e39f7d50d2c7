//! The distribution of the load's directions, as far as moments up to degree four tell it.
//!
//! The covariance of the metric constraint needs moments of degree six of the direction m, which nobody sums up. But the
//! density of m on the unit sphere is known up to degree four: its part of degree l at a direction q is
//! (2l + 1)·⟨Pₗ(q·m)⟩ in space and 2·⟨Tₗ(q·m)⟩ in the plane (addition theorem; Legendre and Chebyshev polynomials). The
//! parts beyond degree four are taken as zero; moments of degree six are then sums over a quadrature that is exact for
//! degree ten.

use nalgebra::SVector;

use super::coordinates::{Fourth, MotionVector, Second, Third};
use super::motion_moments::MotionMoments;
use crate::units::{MAX_RANK, Rank};

/// Nodes of the Gauss-Legendre rule of six points on [−1, 1], and its weights over their sum.
const LEGENDRE: [(f64, f64); 6] = [
    (0.238_619_186_083_196_9, 0.467_913_934_572_691 / 2.0),
    (-0.238_619_186_083_196_9, 0.467_913_934_572_691 / 2.0),
    (0.661_209_386_466_264_5, 0.360_761_573_048_138_6 / 2.0),
    (-0.661_209_386_466_264_5, 0.360_761_573_048_138_6 / 2.0),
    (0.932_469_514_203_152, 0.171_324_492_379_170_35 / 2.0),
    (-0.932_469_514_203_152, 0.171_324_492_379_170_35 / 2.0),
];

/// Steps around the circle: exact for degree ten.
const AROUND: usize = 12;

/// Cosine and sine of half a step, 15°.
const HALF_STEP: (f64, f64) = (0.965_925_826_289_068_3, 0.258_819_045_102_520_76);

/// Cosine and sine of a step, 30°.
const STEP: (f64, f64) = (0.866_025_403_784_438_6, 0.5);

/// Moments of the load's direction m about zero, less the noise; |m| = 1 on average.
#[derive(Clone, Debug)]
pub struct DirectionMoments {
    /// Whether these are directions in the plane or in space.
    pub rank: Rank,
    /// ⟨m⟩.
    pub first: MotionVector,
    /// Degrees two to four.
    pub higher: MotionMoments,
}

impl DirectionMoments {
    /// From central moments and the mean.
    pub fn new(rank: Rank, mean: MotionVector, central: &MotionMoments) -> Self {
        Self { rank, higher: central.about_zero(&mean), first: mean }
    }

    /// The density of m on the unit sphere or circle.
    #[expect(clippy::cast_possible_truncation, reason = "a density needs five digits")]
    pub fn density(&self) -> Density {
        let MotionMoments { second, third, fourth } = &self.higher;
        let mut single = Second::ZERO;
        for a in 0..MAX_RANK {
            for b in a..MAX_RANK {
                single[[a, b]] = second[(a, b)];
            }
        }
        Density {
            rank: self.rank,
            first: self.first.map(|component| component as f32),
            second: single.rounded(),
            third: third.rounded(),
            fourth: fourth.rounded(),
        }
    }

    /// The mean square of the density over the sphere or circle: 1 for directions all over, 1/A for directions all over a
    /// share A of it, as far as degree four tells.
    ///
    /// With the density's parts as above, it is the same sum over ⟨(m·m′)ᵏ⟩ for two independent directions m and m′, which
    /// is the squared norm of the moment tensor of degree k.
    pub fn concentration(&self) -> f64 {
        let MotionMoments { second, third, fourth } = &self.higher;
        let mut norms = [self.first.norm_squared(), second.norm_squared(), 0.0, 0.0];
        for a in 0..MAX_RANK {
            for b in a..MAX_RANK {
                for c in b..MAX_RANK {
                    norms[2] += orders(&[a, b, c]) * third[[a, b, c]] * third[[a, b, c]];
                    for d in c..MAX_RANK {
                        norms[3] += orders(&[a, b, c, d]) * fourth[[a, b, c, d]] * fourth[[a, b, c, d]];
                    }
                }
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "a share needs five digits")]
        let norms = norms.map(|norm| norm as f32);
        f64::from(zonal_sum(self.rank, norms))
    }
}

/// The density of the load's directions, relative to the uniform one. In single precision, which the sensor has in hardware: it is
/// asked for many directions.
#[derive(Clone, Debug)]
pub struct Density {
    rank: Rank,
    first: SVector<f32, MAX_RANK>,
    second: Second<f32>,
    third: Third<f32>,
    fourth: Fourth<f32>,
}

impl Density {
    /// The density at a direction; no less than zero.
    pub fn at(&self, q: &SVector<f32, MAX_RANK>) -> f32 {
        // ⟨(q·m)ᵏ⟩ for k = 1 … 4.
        let powers = [
            q.dot(&self.first),
            q.dot(&self.second.along(q)),
            q.dot(&self.third.along(q).along(q)),
            q.dot(&self.fourth.along(q).along(q).along(q)),
        ];
        zonal_sum(self.rank, powers).max(0.0)
    }
}

/// In how many orders these ascending indices can be put.
fn orders(ascending: &[usize]) -> f64 {
    let (mut orders, mut run, mut last) = (1.0, 0.0, usize::MAX);
    for (position, &index) in ascending.iter().enumerate() {
        run = if index == last { run + 1.0 } else { 1.0 };
        orders *= (position as f64 + 1.0) / run;
        last = index;
    }
    orders
}

/// Σ (2l + 1) Pₗ(t) in space, 1 + 2 Σ Tₗ(t) in the plane, l up to four, of the mean powers ⟨t⟩ … ⟨t⁴⟩.
fn zonal_sum(rank: Rank, [t1, t2, t3, t4]: [f32; 4]) -> f32 {
    match rank {
        Rank::Planar => {
            1.0 + 2.0 * (t1 + (2.0 * t2 - 1.0) + (4.0 * t3 - 3.0 * t1) + (8.0 * t4 - 8.0 * t2 + 1.0))
        }
        Rank::Spatial => {
            1.0 + 3.0 * t1
                + 5.0 * (3.0 * t2 - 1.0) / 2.0
                + 7.0 * (5.0 * t3 - 3.0 * t1) / 2.0
                + 9.0 * (35.0 * t4 - 30.0 * t2 + 3.0) / 8.0
        }
    }
}

/// Visits directions all over the unit sphere or circle with weights that sum to one.
pub fn for_each_direction(rank: Rank, mut visit: impl FnMut(MotionVector, f64)) {
    let heights = match rank {
        Rank::Planar => &[(0.0, 1.0)][..],
        Rank::Spatial => &LEGENDRE,
    };
    let mut next = HALF_STEP;
    for _ in 0..AROUND {
        let (cosine, sine) = next;
        // By the addition theorems; each step adds a rounding or two.
        next = (cosine * STEP.0 - sine * STEP.1, sine * STEP.0 + cosine * STEP.1);
        for &(height, weight) in heights {
            let radius = libm::sqrt(1.0 - height * height);
            visit(MotionVector::new(radius * cosine, radius * sine, height), weight / AROUND as f64);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{for_each_direction, orders};
    use crate::units::Rank;

    #[test]
    fn the_orders_are_counted() {
        for (ascending, count) in [
            ([0, 0, 0, 0], 1.0),
            ([0, 1, 1, 1], 4.0),
            ([0, 0, 2, 2], 6.0),
            ([0, 1, 1, 2], 12.0),
            ([0, 1, 2, 3], 24.0),
        ] {
            assert_eq!(orders(&ascending), count);
        }
    }

    /// ⟨x²⟩ = 1/3, ⟨x⁴⟩ = 1/5, ⟨x²y²⟩ = 1/15, ⟨x⁶⟩ = 1/7, ⟨x¹⁰⟩ = 1/11 on the sphere; 1/2, 3/8 and 63/256 on the circle.
    #[test]
    fn the_quadrature_is_exact() {
        let mut sums = [0.0; 6];
        for_each_direction(Rank::Spatial, |q, weight| {
            let terms = [1.0, q.x.powi(2), q.z.powi(4), q.x.powi(2) * q.y.powi(2), q.y.powi(6), q.x.powi(10)];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += weight * term);
        });
        for (sum, exact) in sums.into_iter().zip([1.0, 1.0 / 3.0, 0.2, 1.0 / 15.0, 1.0 / 7.0, 1.0 / 11.0]) {
            assert!((sum - exact).abs() < 1e-14, "{sum} {exact}");
        }
        let mut sums = [0.0; 3];
        for_each_direction(Rank::Planar, |q, weight| {
            let terms = [q.x.powi(2), q.y.powi(4), q.x.powi(10)];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += weight * term);
        });
        for (sum, exact) in sums.into_iter().zip([0.5, 0.375, 63.0 / 256.0]) {
            assert!((sum - exact).abs() < 1e-14, "{sum} {exact}");
        }
    }
}
