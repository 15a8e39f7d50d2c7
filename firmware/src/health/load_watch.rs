//! The load against its limits: overload of each component and of all together, peaks, the user's thresholds.
//!
//! Overload and peaks go by the whole load, without tare: it is the sensor's own body that they are about. Thresholds go by the wrench
//! that is sent.

use ftcal_shared::units::{Dof, MAX_DOF};
use ftcal_shared::wire::health::{StatusBit, StatusWord};
use ftcal_shared::wire::{LoadLimits, Rejection};

/// Limits in the form that the sample path compares with, and what has come of them.
pub(super) struct LoadWatch {
    limits: LoadLimits,
    /// One over each limit; zero where there is none.
    per_limit: [f32; MAX_DOF],
    combined_squared: f32,
    has_limits: bool,
    has_thresholds: bool,
    /// Thresholds that are exceeded: bit k for component k.
    exceeded: u8,
    peak_since_start: [f32; MAX_DOF],
}

impl LoadWatch {
    pub(super) const fn new() -> Self {
        Self {
            limits: LoadLimits::NONE,
            per_limit: [0.0; MAX_DOF],
            combined_squared: f32::INFINITY,
            has_limits: false,
            has_thresholds: false,
            exceeded: 0,
            peak_since_start: [0.0; MAX_DOF],
        }
    }

    pub(super) const fn limits(&self) -> &LoadLimits {
        &self.limits
    }

    pub(super) const fn exceeded(&self) -> u8 {
        self.exceeded
    }

    pub(super) const fn peak_since_start(&self) -> &[f32; MAX_DOF] {
        &self.peak_since_start
    }

    /// Takes these limits, or keeps those that there are.
    pub(super) fn set(&mut self, limits: LoadLimits) -> Result<(), Rejection> {
        // A comparison with no number is false.
        let usable = |limit: f32| limit > 0.0;
        let thresholds_usable = limits.thresholds.iter().all(|threshold| {
            usable(threshold.level) && threshold.hysteresis >= 0.0 && threshold.hysteresis <= threshold.level
        });
        if !(limits.largest.into_iter().all(usable) && usable(limits.combined) && thresholds_usable) {
            return Err(Rejection::UnusableLimit);
        }
        self.limits = limits;
        self.per_limit = limits.largest.map(|limit| 1.0 / limit);
        self.combined_squared = limits.combined * limits.combined;
        // Without a limit of a component there is nothing to be combined.
        self.has_limits = limits.largest.iter().any(|limit| limit.is_finite());
        self.has_thresholds = limits.thresholds.iter().any(|threshold| threshold.level.is_finite());
        self.exceeded = 0;
        Ok(())
    }

    /// Takes in the whole load of one sample, and the wrench that is sent of it; says what is beyond its limits.
    pub(super) fn judge(&mut self, dof: Dof, load: &[f32; MAX_DOF], sent: &[f32; MAX_DOF]) -> StatusWord {
        let [a, b, c, d, e, f] = &mut self.peak_since_start;
        // Component by component: the compiler unrolls nothing where it is to save room.
        raise(a, load[0]);
        raise(b, load[1]);
        raise(c, load[2]);
        raise(d, load[3]);
        raise(e, load[4]);
        raise(f, load[5]);
        let mut word = StatusWord::NONE;
        if self.has_limits {
            word = self.overload(dof, load);
        }
        if self.has_thresholds {
            self.compare_with_thresholds(sent);
            word = word.with(StatusBit::Threshold, self.exceeded != 0);
        }
        word
    }

    fn overload(&self, dof: Dof, load: &[f32; MAX_DOF]) -> StatusWord {
        let (mut combined, mut any) = (0.0, false);
        for (component, per_limit) in load.iter().zip(&self.per_limit) {
            let used = component * per_limit;
            any |= used.abs() > 1.0;
            combined += used * used;
        }
        let too_much_together = combined > self.combined_squared;
        if !any && !too_much_together {
            return StatusWord::NONE;
        }
        let mut word = StatusBit::Overload.word().with(StatusBit::OverloadCombined, too_much_together);
        for ((&axis, component), per_limit) in dof.axes().iter().zip(load).zip(&self.per_limit) {
            word = word.with(StatusBit::overload(axis), component.abs() * per_limit > 1.0);
        }
        word
    }

    fn compare_with_thresholds(&mut self, sent: &[f32; MAX_DOF]) {
        for (component, (value, threshold)) in sent.iter().zip(&self.limits.thresholds).enumerate() {
            let bit = 1 << component;
            let level = if self.exceeded & bit == 0 {
                threshold.level
            } else {
                threshold.level - threshold.hysteresis
            };
            self.exceeded = self.exceeded & !bit | u8::from(value.abs() > level) << component;
        }
    }
}

/// Raises a peak to this magnitude, if it is larger.
#[inline]
const fn raise(peak: &mut f32, component: f32) {
    if component.abs() > *peak {
        *peak = component.abs();
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::{Axis, Dof, MAX_DOF};
    use ftcal_shared::wire::health::{StatusBit, StatusWord};
    use ftcal_shared::wire::{LoadLimits, LoadThreshold, Rejection};

    use super::LoadWatch;

    const WRENCH: Dof = Dof::SpatialForceTorque;

    fn watch(limits: LoadLimits) -> LoadWatch {
        let mut watch = LoadWatch::new();
        assert_eq!(watch.set(limits), Ok(()));
        watch
    }

    fn along(component: usize, value: f32) -> [f32; MAX_DOF] {
        core::array::from_fn(|at| if at == component { value } else { 0.0 })
    }

    #[test]
    fn without_limits_nothing_is_too_much() {
        let mut watch = watch(LoadLimits::NONE);
        assert_eq!(watch.judge(WRENCH, &[1e30; MAX_DOF], &[1e30; MAX_DOF]), StatusWord::NONE);
    }

    #[test]
    fn each_axis_has_its_own_limit_whatever_the_sign_and_whatever_is_tared() {
        let limits = LoadLimits { largest: [10.0, 20.0, 30.0, 1.0, 2.0, 3.0], ..LoadLimits::NONE };
        let mut watch = watch(limits);
        for (component, &axis) in WRENCH.axes().iter().enumerate() {
            for sign in [1.0, -1.0] {
                let limit = sign * limits.largest[component];
                let at = |watch: &mut LoadWatch, value| {
                    watch.judge(WRENCH, &along(component, value), &[0.0; MAX_DOF])
                };
                assert_eq!(at(&mut watch, 0.999 * limit), StatusWord::NONE);
                let expected = StatusBit::Overload.word().with(StatusBit::overload(axis), true);
                assert_eq!(at(&mut watch, 1.001 * limit), expected);
            }
        }
    }

    #[test]
    fn a_planar_sensor_s_torque_is_about_z() {
        let mut watch = watch(LoadLimits { largest: [1.0; MAX_DOF], ..LoadLimits::NONE });
        let word = watch.judge(Dof::PlanarForceTorque, &along(2, 2.0), &[0.0; MAX_DOF]);
        assert!(
            word.contains(StatusBit::overload(Axis::TorqueZ)) && !word.contains(StatusBit::OverloadForceZ)
        );
    }

    #[test]
    fn together_the_components_may_be_too_much_though_none_is_alone() {
        let largest = [10.0, 20.0, 30.0, 1.0, 2.0, 3.0];
        let mut watch = watch(LoadLimits { largest, combined: 1.0, ..LoadLimits::NONE });
        // All six at this share: the root of the summed squares is √6 times it.
        for (share, beyond) in [(0.40, false), (0.41, true)] {
            let load = largest.map(|limit| -share * limit);
            let word = watch.judge(WRENCH, &load, &load);
            let expected = StatusBit::Overload.word().with(StatusBit::OverloadCombined, true);
            assert_eq!(word, if beyond { expected } else { StatusWord::NONE });
        }
    }

    #[test]
    fn a_threshold_is_left_by_its_hysteresis_only() {
        let mut thresholds = [LoadThreshold::NONE; MAX_DOF];
        thresholds[2] = LoadThreshold { level: 5.0, hysteresis: 1.0 };
        let mut watch = watch(LoadLimits { thresholds, ..LoadLimits::NONE });
        let steps =
            [(4.9, false), (5.1, true), (4.5, true), (-4.1, true), (3.9, false), (4.5, false), (-5.1, true)];
        for (value, exceeded) in steps {
            let word = watch.judge(WRENCH, &[100.0; MAX_DOF], &along(2, value));
            assert_eq!(word, StatusWord::NONE.with(StatusBit::Threshold, exceeded), "{value}");
            assert_eq!(watch.exceeded(), if exceeded { 0b100 } else { 0 });
        }
    }

    #[test]
    fn the_peak_is_the_largest_magnitude_so_far() {
        let mut watch = watch(LoadLimits::NONE);
        for value in [1.0, -3.0, 2.0] {
            watch.judge(WRENCH, &along(4, value), &[50.0; MAX_DOF]);
        }
        assert_eq!(watch.peak_since_start(), &along(4, 3.0));
    }

    #[test]
    fn limits_that_are_none_are_rejected_and_change_nothing() {
        let good = LoadLimits { largest: [7.0; MAX_DOF], ..LoadLimits::NONE };
        let mut watch = watch(good);
        for bad in [0.0, -1.0, f32::NAN] {
            assert_eq!(watch.set(LoadLimits { combined: bad, ..good }), Err(Rejection::UnusableLimit));
            let largest = along(3, bad);
            assert_eq!(watch.set(LoadLimits { largest, ..good }), Err(Rejection::UnusableLimit));
            let thresholds = [LoadThreshold { level: bad, hysteresis: 0.0 }; MAX_DOF];
            assert_eq!(watch.set(LoadLimits { thresholds, ..good }), Err(Rejection::UnusableLimit));
        }
        for hysteresis in [-1.0, 5.1, f32::NAN] {
            let thresholds = [LoadThreshold { level: 5.0, hysteresis }; MAX_DOF];
            assert_eq!(watch.set(LoadLimits { thresholds, ..good }), Err(Rejection::UnusableLimit));
        }
        assert_eq!(watch.limits(), &good);
    }
}
