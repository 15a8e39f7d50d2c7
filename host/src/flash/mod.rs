//! Writing the firmware image to the sensor through a debug probe (CMSIS-DAP, ST-Link, J-Link and their like).
//!
//! Three steps, each of which can be done without the next: [`FirmwareImage::read`] checks the file, [`open_probe`]
//! finds the one probe that is meant, [`flash`] attaches to the chip, writes, reads back and restarts it. So a
//! wrong image is refused before any probe is touched, and a doubtful choice of probe before any chip is.
//!
//! Only the sectors that the image needs are erased; whatever else the flash holds stays. Every byte is verified
//! by reading it back. A dry run attaches and plans (flash algorithm, sectors, pages) and writes nothing.
//!
//! Failure: every cause is a variant of [`FlashError`]. After [`FlashError::Write`] or [`FlashError::Verify`]
//! the flash holds neither the old image nor the new one, and flashing once more is the way out.

pub mod image;

#[cfg(test)]
mod fake_probe;
#[cfg(test)]
mod test_elf;

use probe_rs::flashing::{DownloadOptions, FlashProgress, ProgressEvent, ProgressOperation};
use probe_rs::probe::list::Lister;
use probe_rs::probe::{DebugProbeError, DebugProbeSelector, Probe};
use probe_rs::{Permissions, Session};

use image::{FirmwareImage, ImageError};

/// The chip on the sensor's board, by the name that probe-rs knows it by.
pub const CHIP: &str = "STM32F405RGTx";

/// Why the image was not written.
#[derive(Debug, thiserror::Error)]
pub enum FlashError {
    /// The file is no firmware image for this chip.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// No probe is connected, or none that the selector names.
    #[error("no debug probe found{}", of_selector(selector.as_ref()))]
    NoProbe {
        /// Which probe was asked for, if any was.
        selector: Option<DebugProbeSelector>,
    },
    /// Several probes would do; to write to a wrong board is worse than to ask.
    #[error("several debug probes found: {}", probes.join(", "))]
    SeveralProbes {
        /// A selector for each.
        probes: Vec<String>,
    },
    /// The probe is there but could not be opened: in use, or not permitted.
    #[error("the debug probe could not be opened")]
    Open(#[source] Box<DebugProbeError>),
    /// The probe does not reach the chip.
    #[error("the debug probe could not attach to the {CHIP}")]
    Attach(#[source] Box<probe_rs::Error>),
    /// Erasing or programming failed.
    #[error("the flash could not be written")]
    Write(#[source] Box<probe_rs::flashing::FlashError>),
    /// The flash does not read back as written.
    #[error("the flash does not hold what was written")]
    Verify,
    /// The image is in the flash, but the chip could not be restarted.
    #[error("the image is written and verified, but the chip could not be restarted")]
    Restart(#[source] Box<probe_rs::Error>),
}

fn of_selector(selector: Option<&DebugProbeSelector>) -> String {
    selector.map(|selector| format!(" that matches {selector}")).unwrap_or_default()
}

impl From<probe_rs::flashing::FlashError> for FlashError {
    fn from(error: probe_rs::flashing::FlashError) -> Self {
        match error {
            probe_rs::flashing::FlashError::Verify => Self::Verify,
            other => Self::Write(Box::new(other)),
        }
    }
}

/// Whether the chip's flash is changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FlashMode {
    /// Erase, program, verify, restart.
    Write,
    /// Attach and plan only.
    DryRun,
}

/// What is being done to the flash.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FlashStep {
    /// Erasing the sectors that the image needs.
    Erase,
    /// Programming its pages.
    Program,
    /// Reading them back.
    Verify,
}

/// How far a step is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StepProgress {
    /// The step.
    pub step: FlashStep,
    /// Bytes done.
    pub done_bytes: u64,
    /// Bytes to do.
    pub total_bytes: u64,
}

/// Opens the probe that `selector` names, or without one the only probe there is.
///
/// `lister` is `Lister::new()` for the probes on this machine's USB.
///
/// # Errors
/// [`FlashError::NoProbe`], [`FlashError::SeveralProbes`], [`FlashError::Open`].
pub fn open_probe(lister: &Lister, selector: Option<&DebugProbeSelector>) -> Result<Probe, FlashError> {
    match lister.list(selector).as_slice() {
        [] => Err(FlashError::NoProbe { selector: selector.cloned() }),
        [only] => lister.open(only).map_err(|error| FlashError::Open(Box::new(error))),
        several => {
            let probes = several.iter().map(|probe| DebugProbeSelector::from(probe).to_string()).collect();
            Err(FlashError::SeveralProbes { probes })
        }
    }
}

/// Writes `image` to the chip that `probe` is connected to, and tells `on_progress` how it goes.
///
/// # Errors
/// [`FlashError::Attach`], [`FlashError::Write`], [`FlashError::Verify`], [`FlashError::Restart`].
pub fn flash(
    probe: Probe,
    image: &FirmwareImage,
    mode: FlashMode,
    on_progress: impl FnMut(StepProgress),
) -> Result<(), FlashError> {
    let mut session =
        probe.attach(CHIP, Permissions::default()).map_err(|error| FlashError::Attach(Box::new(error)))?;

    let mut loader = session.target().flash_loader();
    for segment in image.segments() {
        loader.add_data(segment.address, &segment.bytes)?;
    }

    let mut tally = Tally::new(on_progress);
    let mut options = DownloadOptions::new();
    options.progress = FlashProgress::new(|event| tally.count(&event));
    options.verify = true;
    options.dry_run = mode == FlashMode::DryRun;
    loader.commit(&mut session, options)?;

    match mode {
        FlashMode::Write => restart(&mut session),
        FlashMode::DryRun => Ok(()),
    }
}

/// Starts the new image: the flash algorithm leaves the core halted in RAM.
fn restart(session: &mut Session) -> Result<(), FlashError> {
    session.core(0).and_then(|mut core| core.reset()).map_err(|error| FlashError::Restart(Box::new(error)))
}

/// Adds up the events of probe-rs, which names each block's size and not how far it is.
struct Tally<OnProgress> {
    steps: [StepProgress; 3],
    on_progress: OnProgress,
}

impl<OnProgress: FnMut(StepProgress)> Tally<OnProgress> {
    fn new(on_progress: OnProgress) -> Self {
        let steps = [FlashStep::Erase, FlashStep::Program, FlashStep::Verify].map(|step| StepProgress {
            step,
            done_bytes: 0,
            total_bytes: 0,
        });
        Self { steps, on_progress }
    }

    fn count(&mut self, event: &ProgressEvent) {
        match event {
            ProgressEvent::AddProgressBar { operation, total } => {
                if let Some(progress) = self.progress_of(*operation) {
                    progress.total_bytes += total.unwrap_or(0);
                }
            }
            ProgressEvent::Progress { operation, size, .. } => {
                if let Some(progress) = self.progress_of(*operation) {
                    progress.done_bytes += size;
                    let progress = *progress;
                    (self.on_progress)(progress);
                }
            }
            // Starts, ends and failures say nothing that the bytes and the result do not.
            _ => {}
        }
    }

    fn progress_of(&mut self, operation: ProgressOperation) -> Option<&mut StepProgress> {
        let step = match operation {
            ProgressOperation::Erase => FlashStep::Erase,
            ProgressOperation::Program => FlashStep::Program,
            ProgressOperation::Verify => FlashStep::Verify,
            // Sectors are not filled up with their old contents.
            ProgressOperation::Fill => return None,
        };
        self.steps.iter_mut().find(|progress| progress.step == step)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use probe_rs::Permissions;
    use probe_rs::flashing::{ProgressEvent, ProgressOperation};
    use probe_rs::integration::FakeProbe;
    use probe_rs::probe::{DebugProbeError, DebugProbeSelector, Probe};

    use super::fake_probe::{UnconnectedProbe, lister_of};
    use super::image::{CHIP_FLASH, FirmwareImage};
    use super::test_elf::elf;
    use super::{CHIP, FlashError, FlashMode, FlashStep, StepProgress, Tally, flash, open_probe};

    fn small_image() -> FirmwareImage {
        let vectors = [0x2002_0000_u32, 0x0800_0009].map(u32::to_le_bytes).concat();
        FirmwareImage::parse(&elf(&[(0x0800_0000, &vectors[..]), (0x0800_0008, &[0xfe, 0xe7])])).unwrap()
    }

    #[test]
    fn a_dry_run_attaches_plans_and_writes_nothing() {
        let probe = FakeProbe::with_mocked_core().into_probe();
        let mut steps = Vec::new();
        flash(probe, &small_image(), FlashMode::DryRun, |progress| steps.push(progress)).unwrap();
        assert_eq!(steps, []);
    }

    #[test]
    fn the_flash_that_images_are_checked_against_is_that_of_the_chip() {
        let probe = FakeProbe::with_mocked_core().into_probe();
        let session = probe.attach(CHIP, Permissions::default()).unwrap();
        let regions = session.target().memory_map.iter().filter_map(|region| region.as_nvm_region());
        assert_eq!(regions.filter(|region| region.range == CHIP_FLASH).count(), 1);
    }

    #[test]
    fn segments_that_overlap_are_refused() {
        let overlapping = [(0x0800_0000, &[1, 2, 3, 4][..]), (0x0800_0002, &[5, 6])];
        let image = FirmwareImage::parse(&elf(&overlapping)).unwrap();
        let probe = FakeProbe::with_mocked_core().into_probe();
        assert!(matches!(flash(probe, &image, FlashMode::DryRun, |_| {}), Err(FlashError::Write(_))));
    }

    #[test]
    fn a_chip_that_does_not_answer_is_an_attach_failure() {
        let probe = Probe::from_specific_probe(Box::new(UnconnectedProbe));
        let refused = flash(probe, &small_image(), FlashMode::DryRun, |_| {});
        let Err(FlashError::Attach(cause)) = refused else { panic!("{refused:?}") };
        assert!(matches!(*cause, probe_rs::Error::Probe(DebugProbeError::TargetNotFound)));
    }

    #[test]
    fn the_only_probe_is_opened_without_being_named() {
        assert!(open_probe(&lister_of(&["A"]), None).is_ok());
    }

    #[test]
    fn no_probe_is_refused() {
        let refused = open_probe(&lister_of(&[]), None);
        assert!(matches!(refused, Err(FlashError::NoProbe { selector: None })));
    }

    #[test]
    fn of_several_probes_one_must_be_named() {
        let lister = lister_of(&["A", "B"]);
        let Err(FlashError::SeveralProbes { probes }) = open_probe(&lister, None) else {
            panic!("opened one")
        };
        assert_eq!(probes.len(), 2);
        // Each selector that the refusal offers settles the choice.
        for probe in &probes {
            assert!(open_probe(&lister, Some(&probe.parse().unwrap())).is_ok(), "{probe}");
        }
    }

    #[test]
    fn a_selector_that_no_probe_matches_is_named() {
        let selector: DebugProbeSelector = "0483:374b:C".parse().unwrap();
        let Err(error) = open_probe(&lister_of(&["A", "B"]), Some(&selector)) else { panic!("opened one") };
        assert!(error.to_string().contains("0483:374b:C"), "{error}");
    }

    #[test]
    fn a_difference_on_reading_back_is_not_a_write_failure() {
        use probe_rs::flashing::FlashError as Cause;
        assert!(matches!(FlashError::from(Cause::Verify), FlashError::Verify));
        assert!(matches!(FlashError::from(Cause::FlashAlgorithmNotLoaded), FlashError::Write(_)));
    }

    #[test]
    fn progress_adds_up_to_the_total_of_each_step() {
        let mut seen = Vec::new();
        let mut tally = Tally::new(|progress: StepProgress| seen.push(progress));
        let block = |operation| ProgressEvent::Progress { operation, size: 512, time: Duration::ZERO };
        for operation in [ProgressOperation::Erase, ProgressOperation::Program, ProgressOperation::Verify] {
            tally.count(&ProgressEvent::AddProgressBar { operation, total: Some(1024) });
        }
        for operation in [ProgressOperation::Erase, ProgressOperation::Program, ProgressOperation::Verify] {
            tally.count(&ProgressEvent::Started(operation));
            tally.count(&block(operation));
            tally.count(&block(operation));
            tally.count(&ProgressEvent::Finished(operation));
        }
        tally.count(&block(ProgressOperation::Fill));
        let expected = [FlashStep::Erase, FlashStep::Program, FlashStep::Verify]
            .map(|step| [512, 1024].map(|done_bytes| StepProgress { step, done_bytes, total_bytes: 1024 }));
        assert_eq!(seen, expected.concat());
    }
}
