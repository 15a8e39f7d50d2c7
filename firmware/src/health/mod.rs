//! Health: what the sensor knows of itself, and what it therefore lets through as a wrench.
//!
//! | file | watches |
//! |---|---|
//! | `input_watch` | inputs that repeat themselves |
//! | `parity_monitor` | gages that contradict each other; says which |
//! | `load_watch` | overload, peaks, thresholds |
//! | `tare` | what is subtracted |
//! | `self_test`, `injector` | itself: plays faults on the converter's bus, and looks whether they are found |
//!
//! Every sample of a calibrated sensor goes through [`Health::measure`], streamed or not. It is a wrench only where nothing speaks
//! against it; what does is in the status word, whose bits are explained in [`ftcal_shared::wire::health`].

mod injector;
mod input_watch;
mod load_watch;
mod parity_monitor;
mod self_test;
mod tare;

use ftcal_shared::estimation::application::RealTimeCalibration;
use ftcal_shared::estimation::parity::ParitySpace;
use ftcal_shared::fault::AdcFault;
use ftcal_shared::units::{DataRate, Dof, MAX_DOF};
use ftcal_shared::wire::health::{StatusBit, StatusWord};
use ftcal_shared::wire::{HealthReport, InvalidCause, LoadLimits, Rejection, TareReport};
use serde::{Deserialize, Serialize};

use crate::acquisition::Sample;

pub(crate) use injector::{Injection, Injector};
pub(crate) use input_watch::InputWatch;
use load_watch::LoadWatch;
use parity_monitor::ParityMonitor;
pub(crate) use self_test::{Observed, SelfTest};
use tare::{Averaged, Tare};

/// What outlives a reset, where it is stored with the settings: see [`Health::kept`] and [`Health::restore`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeptHealth {
    /// The limits of the load.
    pub limits: LoadLimits,
    /// What the sensor measured when they were set: to other axes they mean nothing.
    pub of: Option<Dof>,
    /// The tare, if it was to be kept.
    pub tare: Option<KeptTare>,
}

impl KeptHealth {
    /// That of a sensor that has nothing kept.
    pub const NONE: Self = Self { limits: LoadLimits::NONE, of: None, tare: None };
}

/// The largest loads ever. They outlive a reset without being asked to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeptPeaks {
    /// What the sensor measures: loads of other axes are forgotten with them.
    pub of: Dof,
    /// The largest magnitude of each component, newton and newton metre.
    pub largest: [f32; MAX_DOF],
}

/// By how much a peak must have grown to be worth a write. A lifetime of loads, from the smallest to the largest, takes a few hundred.
const GROWTH: f32 = 1.05;

/// A tare that outlives a reset.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeptTare {
    /// What is subtracted, newton and newton metre.
    pub wrench: [f32; MAX_DOF],
    /// Identity of the calibration that it was measured with: to any other it means nothing.
    pub calibration: u32,
}

/// What is known of the sensor's health.
pub struct Health<const GAGES: usize> {
    /// What is so until somebody says otherwise.
    lasting: StatusWord,
    live: StatusWord,
    latched: StatusWord,
    saturated: u16,
    repeating: u16,
    /// The gages in use: bit k for gage k.
    in_use: u16,
    left_out: Option<u8>,
    /// ‖π‖² of the last sample, over what noise alone makes of it in the mean.
    chi_square: Option<f32>,
    /// What was made of the last sample that made one.
    wrench: [f32; MAX_DOF],
    /// The signal of the last sample that a calibration was applied to, counts: to clear it for every sample would take as long as to fill it.
    signal: [f32; GAGES],
    parity: Option<ParityMonitor<GAGES>>,
    loads: LoadWatch,
    tare: Tare,
    /// Identity of the calibration that the tare is of.
    calibration: u32,
    basis: u8,
    /// What is measured, since a calibration is in use.
    dof: Option<Dof>,
    kept: KeptHealth,
    kept_peaks: Option<KeptPeaks>,
}

impl<const GAGES: usize> Health<GAGES> {
    /// Of a sensor that has measured nothing yet.
    pub const fn new() -> Self {
        Self {
            lasting: StatusBit::Unwatched.word(),
            live: StatusBit::Unwatched.word(),
            latched: StatusWord::NONE,
            saturated: 0,
            repeating: 0,
            in_use: u16::MAX >> (u16::BITS as usize - GAGES),
            left_out: None,
            chi_square: None,
            wrench: [0.0; MAX_DOF],
            signal: [0.0; GAGES],
            parity: None,
            loads: LoadWatch::new(),
            tare: Tare::new(),
            calibration: 0,
            basis: 0,
            dof: None,
            kept: KeptHealth::NONE,
            kept_peaks: None,
        }
    }

    /// The status word as it is now.
    pub const fn live(&self) -> StatusWord {
        self.live
    }

    /// Forgets what was, but for what still is.
    pub const fn clear_latched(&mut self) {
        self.latched = self.live;
    }

    /// Says that something is so, or not, until somebody says otherwise.
    pub const fn set(&mut self, bit: StatusBit, set: bool) {
        self.lasting = self.lasting.without(bit).with(bit, set);
        self.live = self.live.without(bit).with(bit, set);
        self.latched = self.latched.with(bit, set);
    }

    /// A calibration came into use, with its parity space: the gages are all in use, or all but one.
    pub fn watch(&mut self, space: ParitySpace<GAGES>, left_out: Option<u8>, rate: DataRate) {
        let all = u16::MAX >> (u16::BITS as usize - GAGES);
        self.basis = self.basis.wrapping_add(1);
        self.left_out = left_out;
        self.in_use = left_out.map_or(all, |gage| all & !(1 << gage));
        self.parity = ParityMonitor::new(space, rate);
        self.set(StatusBit::CarryOn, left_out.is_some());
        self.set(StatusBit::Unwatched, self.parity.is_none());
    }

    /// The wrenches of another calibration begin: a tare was of the one before. Where it measures something else, so were limits and peaks.
    pub fn start_anew(&mut self, calibration: u32, dof: Dof) {
        self.calibration = calibration;
        self.tare.put(None);
        self.tare_changed(false);
        if self.dof.replace(dof).is_some_and(|before| before != dof) {
            self.loads = LoadWatch::new();
            self.kept = KeptHealth { tare: self.kept.tare, ..KeptHealth::NONE };
        }
    }

    /// Learns the noise anew: the converter's rate or gain is another, or its codes were not the gages'.
    pub fn relearn(&mut self, rate: DataRate) {
        self.parity = self.parity.take().and_then(|monitor| ParityMonitor::new(monitor.into_space(), rate));
    }

    /// The gages whose faults show: bit k for gage k.
    pub(crate) fn watched(&self) -> u16 {
        let watching = self.parity.as_ref().filter(|monitor| monitor.is_watching());
        watching.map_or(0, |monitor| monitor.space().watched())
    }

    /// The gages in use: bit k for gage k.
    pub(crate) const fn in_use(&self) -> u16 {
        self.in_use
    }

    /// By how much the gages contradicted each other in the last sample: the square of their parity over what noise alone makes of it
    /// in the mean. `None` where nobody can tell.
    pub const fn chi_square(&self) -> Option<f32> {
        self.chi_square
    }

    /// The wrench that [`Health::measure`] has made last, newton and newton metre, with the tare subtracted. Nothing unless it has
    /// made one.
    pub const fn wrench(&self) -> &[f32; MAX_DOF] {
        &self.wrench
    }

    /// Makes a wrench of a sample, or says why it is none. `calibration` is what is applied, or why nothing is; `saturated` the gages
    /// that stand at an end of the range. The wrench itself is [`Health::wrench`]: moved about inside of a result, it would cost more
    /// than it costs to make.
    ///
    /// # Errors
    ///
    /// Why it is none.
    pub fn measure(
        &mut self,
        calibration: Result<&RealTimeCalibration<GAGES>, InvalidCause>,
        saturated: u16,
        sample: &Sample<GAGES>,
    ) -> Result<(), InvalidCause> {
        self.saturated = saturated;
        self.repeating = sample.repeating;
        self.chi_square = None;
        let (saturated, repeating) = (saturated & self.in_use, sample.repeating & self.in_use);
        let of_sample = StatusWord::NONE
            .with(StatusBit::ConversionsLost, sample.after_gap)
            .with(StatusBit::Saturated, saturated != 0)
            .with(StatusBit::OpenInput, repeating != 0);
        self.note(of_sample);
        let testing = self.is_testing();
        let measured = match calibration {
            _ if testing && (saturated | repeating) != 0 => Err(InvalidCause::SelfTest),
            Err(cause) => Err(cause),
            Ok(_) if saturated != 0 => Err(InvalidCause::Saturated(saturated)),
            Ok(_) if repeating != 0 => Err(InvalidCause::OpenInput(repeating)),
            Ok(calibration) => self.apply(calibration, sample),
        };
        if testing {
            return Err(InvalidCause::SelfTest);
        }
        if measured.is_err() {
            self.tare.offer(None);
        }
        self.latched = self.latched.union(self.live);
        measured
    }

    fn apply(
        &mut self,
        calibration: &RealTimeCalibration<GAGES>,
        sample: &Sample<GAGES>,
    ) -> Result<(), InvalidCause> {
        calibration.read_signal(&sample.codes, &mut self.signal);
        if let Some(monitor) = &mut self.parity {
            let judged = monitor.judge(&self.signal);
            self.chi_square = monitor.is_watching().then_some(judged.chi_square);
            self.live = self
                .live
                .with(StatusBit::GagesContradict, judged.contradicts)
                .with(StatusBit::GageSuspect, monitor.is_suspicious())
                .with(StatusBit::Unwatched, !monitor.is_watching());
            if judged.contradicts {
                return Err(InvalidCause::GagesContradict);
            }
        }
        let load = calibration.wrench(&self.signal);
        self.wrench = self.tare.subtracted(&load);
        if !self.is_testing() {
            self.live = self.live.union(self.loads.judge(calibration.dof(), &load, &self.wrench));
            if self.tare.is_averaging()
                && let Averaged::Set { store } = self.tare.offer(Some(&load))
            {
                self.tare_changed(store);
            }
        }
        Ok(())
    }

    /// What is so with this sample, besides what lasts.
    const fn note(&mut self, of_sample: StatusWord) {
        self.live = self.lasting.union(of_sample);
    }

    const fn is_testing(&self) -> bool {
        self.lasting.contains(StatusBit::SelfTest)
    }

    /// There is no sample, because of this.
    pub fn note_fault(&mut self, disturbance: bool) {
        let bit = if disturbance { StatusBit::ReplyDisturbed } else { StatusBit::AdcFault };
        self.note(bit.word());
        self.tare.offer(None);
        if !self.is_testing() {
            self.latched = self.latched.union(self.live);
        }
    }

    /// How the sensor is.
    pub fn report(&self) -> HealthReport {
        HealthReport {
            live: self.live,
            latched: self.latched,
            saturated: self.saturated,
            repeating: self.repeating,
            parity: self.parity.as_ref().map(ParityMonitor::report),
            carrying_on_without: self.left_out,
            thresholds: self.loads.exceeded(),
            peak_since_start: *self.loads.peak_since_start(),
            peak_ever: self.peak_ever(),
        }
    }

    /// The limits of the load.
    pub const fn limits(&self) -> &LoadLimits {
        self.loads.limits()
    }

    /// Takes other limits of the load.
    ///
    /// # Errors
    ///
    /// [`Rejection::UnusableLimit`].
    pub fn set_limits(&mut self, limits: LoadLimits) -> Result<(), Rejection> {
        self.loads.set(limits)?;
        self.kept.limits = limits;
        self.kept.of = self.dof;
        Ok(())
    }

    /// The tare.
    pub fn tare(&self) -> TareReport {
        self.tare.report()
    }

    /// Takes a tare from the next so many samples.
    ///
    /// # Errors
    ///
    /// [`Rejection::UnusableLimit`] where that is none.
    pub fn start_tare(&mut self, samples: u16, store: bool) -> Result<(), Rejection> {
        self.tare.start(samples, store)
    }

    /// Subtracts nothing any more.
    pub fn clear_tare(&mut self, store: bool) {
        self.tare.put(None);
        self.tare_changed(store);
    }

    /// A number that changes with whatever wrenches are made of: the calibration, the gages in use, the tare. Wrenches of different
    /// numbers are not to be averaged.
    pub const fn basis(&self) -> u8 {
        self.basis
    }

    fn tare_changed(&mut self, store: bool) {
        self.basis = self.basis.wrapping_add(1);
        let report = self.tare.report();
        self.set(StatusBit::TareActive, report.wrench.is_some());
        if store {
            let calibration = self.calibration;
            self.kept.tare = report.wrench.map(|wrench| KeptTare { wrench, calibration });
        }
    }

    fn peak_ever(&self) -> [f32; MAX_DOF] {
        let since_start = self.loads.peak_since_start();
        let before = self.peak_kept();
        core::array::from_fn(|component| before[component].max(since_start[component]))
    }

    /// The peaks that are kept, where they are of what is measured now.
    fn peak_kept(&self) -> [f32; MAX_DOF] {
        let of_this = |peaks: &KeptPeaks| Some(peaks.of) == self.dof;
        self.kept_peaks.filter(of_this).map_or([0.0; MAX_DOF], |peaks| peaks.largest)
    }

    /// What is to outlive a reset, as it is now: for whoever stores it.
    pub const fn kept(&self) -> &KeptHealth {
        &self.kept
    }

    /// The peaks, where they have grown so much beyond those that are kept that they should be.
    pub fn grown_peaks(&self) -> Option<KeptPeaks> {
        let of = self.dof?;
        let (kept, since_start) = (self.peak_kept(), self.loads.peak_since_start());
        let has_grown = since_start.iter().zip(&kept).any(|(now, before)| *now > GROWTH * before);
        has_grown.then(|| KeptPeaks { of, largest: self.peak_ever() })
    }

    /// Takes up the peaks that are kept.
    pub fn note_kept_peaks(&mut self, peaks: Option<KeptPeaks>) {
        // They were numbers when they were stored; should they be none all the same, there are none rather than wrong ones.
        self.kept_peaks = peaks.filter(|peaks| peaks.largest.iter().all(|peak| peak.is_finite()));
    }

    /// Takes up what was stored before a reset; the calibration comes first. The tare of another calibration is left out, and so are the
    /// limits of other axes.
    pub fn restore(&mut self, kept: KeptHealth) {
        self.kept.tare = kept.tare;
        let of_these_axes = kept.of.is_none() || self.dof.is_none() || kept.of == self.dof;
        // They were checked before they were stored; should they be broken all the same, there are none rather than wrong ones.
        if of_these_axes && self.set_limits(kept.limits).is_ok() {
            self.kept.of = kept.of;
        }
        let of_this = |tare: &KeptTare| {
            tare.calibration == self.calibration && tare.wrench.iter().all(|component| component.is_finite())
        };
        if let Some(tare) = kept.tare.filter(of_this) {
            self.tare.put(Some(tare.wrench));
            self.tare_changed(false);
        }
    }
}

impl<const GAGES: usize> Default for Health<GAGES> {
    fn default() -> Self {
        Self::new()
    }
}

/// Whether a fault is a disturbance of one transfer, which the next may be free of. Everything else says that the converter is no longer
/// what it was set up to be.
pub(crate) const fn is_disturbance(fault: AdcFault) -> bool {
    matches!(
        fault,
        AdcFault::ReplyCorrupted | AdcFault::CommandCorrupted | AdcFault::StaleConversion | AdcFault::Bus
    )
}
