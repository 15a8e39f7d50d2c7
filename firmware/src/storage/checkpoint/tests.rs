//! Trials through resets, with the power failing at every word of a checkpoint and at every stage of an erase.

extern crate std;

use std::boxed::Box;

use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::units::{AdcCode, DataRate, DeviceTime, Gain, SampleIndex};
use ftcal_shared::wire::{Resumption, Solution, TrialPhase, TrialStatus};

use super::super::items::Settings;
use super::super::mock::{ERASE_STAGES, MockFlash};
use super::{Checkpoints, INTERVAL_MICROS, Layout, TrialAccess};
use crate::trial::Trial;

const GAGES: usize = 3;
const HIGHER: usize = 25;
type Store = Box<Bins<GAGES, HIGHER>>;

const SETTINGS: Settings = Settings { data_rate: DataRate::Hz2000, gain: Gain::X32 };

/// A trial to which a sample comes whenever somebody has looked at it a few times.
struct Bench {
    trial: Trial<Store, GAGES, HIGHER>,
    looks: u32,
    looks_a_sample: u32,
    next: u32,
}

impl Bench {
    fn new() -> Self {
        Self { trial: Trial::new(Box::new(Bins::new())), looks: 0, looks_a_sample: u32::MAX, next: 0 }
    }

    /// A load that is turned and rests in between, with some noise.
    fn offer(&mut self, samples: u32) {
        for _ in 0..samples {
            let sample = self.next;
            self.next += 1;
            let turn = f64::from(sample / 200 * 200 + (sample % 200).min(100)) / 90.0;
            let noise = 50.0 * (f64::from(sample * 7919 % 13) - 6.0);
            let shape = [(4e5, 0.0), (1e5, 3e5), (-2e5, 2e5)];
            #[expect(clippy::cast_possible_truncation, reason = "rounded to whole counts")]
            let codes = shape.map(|(x, y)| {
                AdcCode::saturating((x * libm::cos(turn) + y * libm::sin(turn) + noise) as i64)
            });
            self.trial.offer(SampleIndex::new(sample), &codes, false);
        }
    }

    fn status(&self) -> TrialStatus {
        self.trial.status()
    }
}

impl TrialAccess<Store, GAGES, HIGHER> for Bench {
    fn with<Answer>(&mut self, act: impl FnOnce(&mut Trial<Store, GAGES, HIGHER>) -> Answer) -> Answer {
        self.looks += 1;
        if self.looks.is_multiple_of(self.looks_a_sample) {
            self.offer(1);
        }
        act(&mut self.trial)
    }

    fn undisturbed<Answer>(&mut self, act: impl FnOnce(&mut Self) -> Answer) -> Answer {
        act(self)
    }
}

/// A running trial with its checkpoints, in a flash.
struct Life {
    flash: MockFlash,
    checkpoints: Checkpoints,
    bench: Bench,
    seconds: u64,
}

impl Life {
    /// After a reset.
    fn new(flash: MockFlash) -> Self {
        let mut life = Self { flash, checkpoints: Checkpoints::new(), bench: Bench::new(), seconds: 0 };
        let settings = life.checkpoints.resume(&mut life.flash, &mut life.bench).unwrap();
        let runs = life.bench.status().phase == TrialPhase::Running;
        assert_eq!(settings, runs.then_some(SETTINGS));
        life
    }

    fn begin(&mut self, may_erase: bool) {
        self.checkpoints.begin(&mut self.flash, GAGES, may_erase);
        self.bench.trial.start(2, SETTINGS).unwrap();
    }

    /// As many samples and seconds, with a look after each.
    fn run(&mut self, seconds: u64) {
        for _ in 0..seconds {
            self.bench.offer(100);
            self.seconds += 1;
            self.attend();
        }
    }

    fn attend(&mut self) {
        let now = DeviceTime::from_micros(self.seconds * 1_000_000);
        self.checkpoints.attend(&mut self.flash, now, &mut self.bench);
    }

    fn stop(&mut self) {
        self.bench.trial.stop().unwrap();
        self.attend();
    }
}

/// A trial of one minute, running.
fn running() -> Life {
    let mut life = Life::new(MockFlash::new());
    life.begin(true);
    life.run(60);
    life
}

#[test]
fn a_trial_goes_on_from_its_last_checkpoint_and_says_so() {
    let mut life = running();
    life.run(7);
    let before = life.bench.status();
    assert_eq!(before.resumption, Resumption::None);
    let mut life = Life::new(life.flash);
    let after = life.bench.status();
    assert_eq!((after.phase, after.rank, after.resumption), (TrialPhase::Running, 2, Resumption::Resumed));
    assert_eq!((after.used, after.checkpointed), (before.checkpointed, before.checkpointed));
    // What came since the last checkpoint is lost: less than an interval, and what waited in gate and batches.
    let interval = u32::try_from(INTERVAL_MICROS / 1_000_000).unwrap() * 100;
    assert!(before.offered - after.offered <= interval && before.used - after.used <= interval + 28 + 3 * 32);
    life.run(60);
    assert!(life.bench.status().checkpointed > before.checkpointed);
}

#[test]
fn a_stopped_trial_is_solved_after_a_reset_as_before() {
    let mut life = running();
    life.run(3);
    life.stop();
    let solved = |life: &mut Life| {
        let mut job = life.bench.trial.take_for_solving().unwrap();
        let solution = job.solve().unwrap();
        life.bench.trial.finish(job);
        solution
    };
    let before = solved(&mut life);
    let mut life = Life::new(life.flash);
    assert_eq!(life.bench.status().phase, TrialPhase::Stopped);
    let after = solved(&mut life);
    // Sums of degree 3 and 4 were rounded, which may decide from which classes the answer is taken; both are as good.
    let gram = |solution: &Solution, i: usize, j: usize| -> f64 {
        let (x, y) = solution.shape_counts_per_load.split_at(GAGES);
        x[i] * x[j] + y[i] * y[j]
    };
    let largest = (0..GAGES).map(|gage| gram(&before, gage, gage)).fold(0.0, f64::max);
    for i in 0..GAGES {
        assert!((before.bias_counts[i] - after.bias_counts[i]).abs() < 1e-3 * libm::sqrt(largest));
        for j in 0..GAGES {
            assert!((gram(&before, i, j) - gram(&after, i, j)).abs() < 1e-3 * largest);
        }
    }
    let written = life.flash.written;
    life.run(60);
    assert_eq!(life.flash.written, written, "it is kept already");
}

#[test]
fn a_cut_checkpoint_leaves_the_one_before_or_itself() {
    let mut life = running();
    let old = life.bench.status().checkpointed;
    let before = life.flash.clone();
    life.run(10);
    let new = life.bench.status().checkpointed;
    assert!(new > old);
    let words = life.flash.written - before.written;
    for cut in 1..=words + 1 {
        let mut life = Life::new(before.clone());
        life.flash = before.failing_after(cut, u64::from(cut));
        life.run(11);
        let mut life = Life::new(life.flash.restored());
        let status = life.bench.status();
        assert_eq!((status.phase, status.resumption), (TrialPhase::Running, Resumption::Resumed), "{cut}");
        if cut <= words {
            assert_eq!(status.checkpointed, old, "{cut}");
        } else {
            assert!(status.checkpointed > old, "{cut}");
        }
        // And the next one finds a place.
        life.run(20);
        assert!(Life::new(life.flash).bench.status().checkpointed > old);
    }
    assert_eq!(words, Layout::<GAGES>::BYTES / 4);
}

#[test]
fn what_is_cut_before_a_trial_leaves_the_one_before_or_says_that_there_is_none() {
    let mut life = running();
    life.stop();
    life.begin(true);
    life.run(25);
    life.stop();
    let kept = life.bench.status();
    let before = life.flash.clone();
    let (mut old, mut lost) = (0, 0);
    for cut in 1..40 {
        let mut life = Life::new(before.failing_after(cut, u64::from(cut)));
        life.begin(true);
        let failed = life.flash.has_failed();
        let mut life = Life::new(life.flash.restored());
        let status = life.bench.status();
        match status.resumption {
            Resumption::Resumed => {
                old += 1;
                assert_eq!((status.phase, status.used), (TrialPhase::Stopped, kept.used), "{cut}");
            }
            Resumption::Lost => lost += 1,
            Resumption::None => panic!("{cut}: a trial was forgotten"),
        }
        life.begin(true);
        life.run(60);
        assert!(life.bench.status().checkpointed > 0, "{cut}");
        if !failed {
            break;
        }
    }
    // The seal, the erase, the new seal, and a head that is not whole; then the new trial has none yet.
    assert!(old > ERASE_STAGES && lost == 1, "{old} {lost}");
}

#[test]
fn nothing_is_erased_where_that_is_not_allowed() {
    for flash in [MockFlash::new(), MockFlash::filled_with(|word| word), running().flash] {
        let erased = flash.erased;
        let mut life = Life::new(flash);
        if life.bench.status().phase == TrialPhase::Running {
            life.stop();
        }
        life.begin(false);
        life.run(30);
        assert_eq!((life.flash.erased, life.bench.status().checkpointed), (erased, 0));
        life.stop();
        life.begin(true);
        life.run(30);
        assert!(life.flash.erased == erased + 1 && life.bench.status().checkpointed > 0);
    }
}

#[test]
fn a_trial_without_checkpoints_is_lost_and_no_other_is_taken_for_it() {
    let mut life = running();
    life.stop();
    life.begin(true);
    life.run(30);
    life.stop();
    // Both sectors have a trial by now.
    life.begin(false);
    life.run(30);
    let mut life = Life::new(life.flash);
    let status = life.bench.status();
    assert_eq!((status.phase, status.resumption), (TrialPhase::None, Resumption::Lost));
    life.begin(true);
    life.run(30);
    assert!(life.bench.status().checkpointed > 0);
    assert_eq!(Life::new(life.flash).bench.status().resumption, Resumption::Resumed);
}

#[test]
fn a_trial_of_another_number_of_gages_is_not_resumed_and_that_is_said() {
    let mut life = running();
    life.checkpoints.begin(&mut life.flash, GAGES + 1, true);
    assert_eq!(Life::new(life.flash).bench.status().resumption, Resumption::Lost);
}

#[test]
fn samples_that_come_meanwhile_are_taken_in() {
    let mut life = running();
    life.bench.looks_a_sample = 3;
    let offered = life.bench.status().offered;
    life.run(30);
    let status = life.bench.status();
    assert!(status.offered > offered + 3000, "some came while it was saved");
    assert_eq!((status.unattended, status.used), (0, status.offered));
}

#[test]
fn a_trial_of_hours_finds_room() {
    const EIGHT: u32 = Layout::<8>::PLACES;
    let hours = (0..EIGHT - 1).map(Layout::<8>::interval_micros).sum::<u64>() / 3_600_000_000;
    assert!(EIGHT >= 16 && hours >= 5, "{EIGHT} {hours}");
    let mut life = Life::new(MockFlash::new());
    life.begin(true);
    for place in 0..Layout::<GAGES>::PLACES {
        life.bench.offer(100);
        life.attend();
        life.seconds += Layout::<GAGES>::interval_micros(place) / 1_000_000;
        life.bench.offer(1);
        life.attend();
    }
    // The last place is left for the end.
    let written = life.flash.written;
    life.seconds *= 4;
    life.attend();
    assert_eq!(life.flash.written, written);
    life.stop();
    assert!(life.flash.written > written);
    assert_eq!(Life::new(life.flash).bench.status().phase, TrialPhase::Stopped);
}
