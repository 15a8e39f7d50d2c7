//! Checkpoints of a trial: its sums, so that a reset costs no more than what came since the last one.
//!
//! # Where
//!
//! A trial has a sector to itself, and only ever appends to it: nothing is erased while it runs. The other sector holds the trial
//! before, until the next one needs it:
//!
//! ```text
//! seal │ head: number of the trial │ record │ record │ …        (a record has 7.4 KB with eight gages: 17 fit)
//! ```
//!
//! The seal says that the sector was erased to the end; it goes before an erase begins. A record is good if its checksum, its
//! last word, is; the newest good one counts. So whatever is cut short leaves the record before.
//!
//! # When
//!
//! Every ten seconds until a third of the room is used, and then each interval is twice the one before, so that five hours fit:
//! what a reset costs is a share of the trial then. The last place is kept for the trial's end: one that was stopped can be solved
//! after a reset.
//!
//! # How the sample path is kept free
//!
//! Each part of the sums is first copied, by whoever has nothing else to do, in a few ten microseconds in which samples wait
//! ([`Trial::lend`]); then the copy is written, 16 words at a time. Each word stalls the processor for 16 µs.

use core::ops::DerefMut;

use embedded_storage::nor_flash::NorFlash;
use ftcal_shared::estimation::bins::{Bins, Part};
use ftcal_shared::estimation::moments::saved_words;
use ftcal_shared::units::{DataRate, DeviceTime, Gain, SampleIndex};
use ftcal_shared::wire::TrialPhase;

use super::items::Settings;
use super::layout::{ERASED, Fits, SECTOR, WORD};
use super::memory::StorageError;
use super::words::{WordReader, WordWriter, read_word};
use crate::adc::CHANNELS;
use crate::trial::{Counts, Standing, Trial};

mod heads;

use heads::{FIRST_RECORD, Newest};

/// Between two checkpoints, at first.
const INTERVAL_MICROS: u64 = 10_000_000;

/// A hundred days.
const MOST_DOUBLINGS: u32 = 20;

/// After a checkpoint that failed.
const RETRY_MICROS: u64 = 1_000_000;

/// "trla": a record begins.
const RECORD: u32 = u32::from_be_bytes(*b"trla");

/// Words of a record before the sums: its beginning, the trial's number, and where the trial stands.
const STANDING_WORDS: usize = 9;
const WORDS_BEFORE_SUMS: usize = 2 + STANDING_WORDS;

/// Words of the largest part, on the stack of whoever writes it.
const LARGEST_PART: usize = saved_words(CHANNELS);

/// Samples that are taken in for those that wait, before those that wait are given up.
const PATIENCE: u32 = 64;

/// A way to the trial, which others work with at the same time.
pub trait TrialAccess<Store, const GAGES: usize, const HIGHER: usize> {
    /// Does something with the trial. Samples have to wait: a few hundred instructions at most.
    fn with<Answer>(&mut self, act: impl FnOnce(&mut Trial<Store, GAGES, HIGHER>) -> Answer) -> Answer;

    /// Does something during which no request is answered, but samples are taken: a millisecond at most.
    fn undisturbed<Answer>(&mut self, act: impl FnOnce(&mut Self) -> Answer) -> Answer;
}

/// The checkpoints of the trial that runs, or has run.
#[derive(Debug, Default)]
pub struct Checkpoints {
    run: Option<Run>,
}

/// A trial's sector, and how far it is filled.
#[derive(Clone, Copy, Debug)]
struct Run {
    side: u32,
    number: u32,
    /// The next place for a record.
    place: u32,
    due: Option<DeviceTime>,
    /// The trial was stopped, and is kept as it was then.
    is_complete: bool,
}

/// Where a record of a trial over `GAGES` channels lies.
struct Layout<const GAGES: usize>;

impl<const GAGES: usize> Layout<GAGES> {
    #[expect(clippy::cast_possible_truncation, reason = "a few thousand")]
    const BYTES: u32 = {
        let mut words = WORDS_BEFORE_SUMS + 1;
        let mut part = 0;
        while part < Part::ALL.len() {
            words += Part::ALL[part].words(GAGES);
            part += 1;
        }
        words as u32 * WORD
    };
    const PLACES: u32 = (SECTOR - FIRST_RECORD) / Self::BYTES;

    const fn address(side: u32, place: u32) -> u32 {
        side * SECTOR + FIRST_RECORD + place * Self::BYTES
    }

    /// Between the record at this place and the one before.
    const fn interval_micros(place: u32) -> u64 {
        let doublings = place.saturating_sub(Self::PLACES / 3);
        INTERVAL_MICROS << if doublings < MOST_DOUBLINGS { doublings } else { MOST_DOUBLINGS }
    }
}

impl Checkpoints {
    /// No trial.
    pub const fn new() -> Self {
        Self { run: None }
    }

    /// Prepares a sector for a new trial; erases it where that is needed. Where that is needed and may not be, or where the flash fails,
    /// the trial will have no checkpoints; and neither has any other from then on, for it would be taken for this one.
    pub fn begin<Flash: NorFlash>(&mut self, flash: &mut Flash, gages: usize, may_erase: bool) {
        let () = Fits::<Flash>::CHECK;
        let place = heads::begin(flash, gages, may_erase).unwrap_or(None);
        self.run = place.map(|(side, number)| Run { side, number, place: 0, due: None, is_complete: false });
        if self.run.is_none() {
            heads::bury(flash);
        }
    }

    /// Makes a checkpoint if one is due. To be called by whoever has nothing else to do.
    pub fn attend<Flash, Store, Access, const GAGES: usize, const HIGHER: usize>(
        &mut self,
        flash: &mut Flash,
        now: DeviceTime,
        access: &mut Access,
    ) where
        Flash: NorFlash,
        Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
        Access: TrialAccess<Store, GAGES, HIGHER>,
    {
        let Some(run) = &mut self.run else { return };
        let standing = access.with(|trial| trial.standing());
        let is_stopped = standing.phase == TrialPhase::Stopped;
        let reserved = u32::from(!is_stopped);
        let due = *run.due.get_or_insert(later(now, Layout::<GAGES>::interval_micros(run.place)));
        let is_due = match standing.phase {
            TrialPhase::None | TrialPhase::Solving => false,
            TrialPhase::Running => now >= due,
            TrialPhase::Stopped => !run.is_complete,
        };
        if !is_due || run.place + reserved >= Layout::<GAGES>::PLACES {
            return;
        }
        let written = write_record(flash, run, standing, access);
        run.place += 1;
        let wait = match written {
            Some(samples) => {
                access.with(|trial| trial.note_checkpoint(samples));
                run.is_complete = is_stopped;
                Layout::<GAGES>::interval_micros(run.place)
            }
            None => RETRY_MICROS,
        };
        run.due = Some(later(now, wait));
    }

    /// Goes on with the trial that was under way before the reset, if there was one. To be called once, before anything is asked of the
    /// trial. How the converter is to be set for it, if it runs.
    ///
    /// # Errors
    ///
    /// [`StorageError::Flash`]; nothing is resumed then.
    pub fn resume<Flash, Store, Access, const GAGES: usize, const HIGHER: usize>(
        &mut self,
        flash: &mut Flash,
        access: &mut Access,
    ) -> Result<Option<Settings>, StorageError>
    where
        Flash: NorFlash,
        Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
        Access: TrialAccess<Store, GAGES, HIGHER>,
    {
        let (side, number, gages) = match heads::newest(flash)? {
            Newest::None => return Ok(None),
            Newest::Lost => {
                access.with(Trial::note_loss);
                return Ok(None);
            }
            Newest::Trial { side, number, gages } => (side, number, gages),
        };
        let resumed = if gages == GAGES { self.resume_from(flash, side, number, access)? } else { None };
        if resumed.is_none() {
            access.with(Trial::note_loss);
        }
        Ok(resumed.filter(|standing| standing.phase == TrialPhase::Running).map(|standing| standing.settings))
    }

    fn resume_from<Flash, Store, Access, const GAGES: usize, const HIGHER: usize>(
        &mut self,
        flash: &mut Flash,
        side: u32,
        number: u32,
        access: &mut Access,
    ) -> Result<Option<Standing>, StorageError>
    where
        Flash: NorFlash,
        Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
        Access: TrialAccess<Store, GAGES, HIGHER>,
    {
        let mut used = 0;
        while used < Layout::<GAGES>::PLACES && !is_free::<Flash, GAGES>(flash, side, used)? {
            used += 1;
        }
        for place in (0..used).rev() {
            let address = Layout::<GAGES>::address(side, place);
            if !is_whole::<Flash, GAGES>(flash, address)? {
                continue;
            }
            let resumed = access.undisturbed(|access| {
                let mut store = access.with(Trial::lend)?;
                let mut words = WordReader::new(flash, address);
                let standing = read_standing(&mut words, number);
                let restored = standing.and_then(|standing| {
                    store.restore(&mut || words.next_word())?;
                    Some(standing)
                });
                let samples = store.count();
                give_back(store, access);
                let standing = restored?;
                access.with(|trial| trial.resume(standing, samples));
                Some(standing)
            });
            if let Some(standing) = resumed {
                let is_complete = standing.phase == TrialPhase::Stopped;
                self.run = Some(Run { side, number, place: used, due: None, is_complete });
                return Ok(resumed);
            }
        }
        Ok(None)
    }
}

const fn later(now: DeviceTime, micros: u64) -> DeviceTime {
    DeviceTime::from_micros(now.as_micros().saturating_add(micros))
}

fn is_free<Flash: NorFlash, const GAGES: usize>(
    flash: &mut Flash,
    side: u32,
    place: u32,
) -> Result<bool, StorageError> {
    Ok(read_word(flash, Layout::<GAGES>::address(side, place))? == ERASED)
}

fn is_whole<Flash: NorFlash, const GAGES: usize>(
    flash: &mut Flash,
    address: u32,
) -> Result<bool, StorageError> {
    let mut words = WordReader::new(flash, address);
    for _ in 1..Layout::<GAGES>::BYTES / WORD {
        words.next_word().ok_or(StorageError::Flash)?;
    }
    let expected = words.checksum();
    Ok(words.next_word() == Some(expected))
}

/// Writes one record; the samples in it. `None` where the flash fails, or the sums are out.
fn write_record<Flash, Store, Access, const GAGES: usize, const HIGHER: usize>(
    flash: &mut Flash,
    run: &Run,
    standing: Standing,
    access: &mut Access,
) -> Option<u64>
where
    Flash: NorFlash,
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
    Access: TrialAccess<Store, GAGES, HIGHER>,
{
    let mut words = WordWriter::new(flash, Layout::<GAGES>::address(run.side, run.place));
    words.put(RECORD);
    words.put(run.number);
    write_standing(&standing, &mut words);
    let mut samples = 0;
    for part in Part::ALL {
        samples += write_part(part, standing.phase, &mut words, access)?;
    }
    words.finish().ok()?;
    Some(samples)
}

/// Copies one part, and writes the copy; of how many samples it is the sum.
#[inline(never)]
fn write_part<Flash, Store, Access, const GAGES: usize, const HIGHER: usize>(
    part: Part,
    phase: TrialPhase,
    words: &mut WordWriter<'_, Flash>,
    access: &mut Access,
) -> Option<u64>
where
    Flash: NorFlash,
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
    Access: TrialAccess<Store, GAGES, HIGHER>,
{
    let mut copy = heapless::Vec::<u32, LARGEST_PART>::new();
    let samples = access.undisturbed(|access| {
        let mut store = access.with(Trial::lend)?;
        if phase == TrialPhase::Stopped {
            store.finish();
        }
        let mut fits = true;
        let samples = store.save(part, &mut |word| fits &= copy.push(word).is_ok());
        give_back(store, access);
        fits.then_some(samples)
    })?;
    for word in copy {
        words.put(word);
    }
    Some(samples)
}

/// Gives the sums back, once the samples that came meanwhile are in them.
fn give_back<Store, Access, const GAGES: usize, const HIGHER: usize>(store: Store, access: &mut Access)
where
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
    Access: TrialAccess<Store, GAGES, HIGHER>,
{
    let mut patience = PATIENCE;
    let mut lent = access.with(|trial| trial.take_back(store, true));
    while let Some((mut store, codes)) = lent {
        let outcome = store.offer(&codes);
        patience -= 1;
        lent = access.with(|trial| {
            trial.count(outcome);
            trial.take_back(store, patience > 0)
        });
    }
}

fn write_standing<Flash: NorFlash>(standing: &Standing, words: &mut WordWriter<'_, Flash>) {
    let Standing { phase, rank, settings, first, counts, by_button } = standing;
    let is_stopped = u32::from(*phase == TrialPhase::Stopped);
    let kind = is_stopped | (u32::from(*by_button) << 1);
    words.put(kind | (u32::from(*rank) << 8) | (u32::from(settings.gain.factor()) << 16));
    words.put(settings.data_rate.hertz());
    words.put(first.get());
    let Counts { offered, taken, saturated, repeated, contradictory, unattended } = *counts;
    for count in [offered, taken, saturated, repeated, contradictory, unattended] {
        words.put(count);
    }
}

fn read_standing<Flash: NorFlash>(words: &mut WordReader<'_, Flash>, number: u32) -> Option<Standing> {
    if (words.next_word()?, words.next_word()?) != (RECORD, number) {
        return None;
    }
    let [kind, rank, gain, _] = words.next_word()?.to_le_bytes();
    let by_button = kind & 2 != 0;
    let phase = if kind & 1 == 0 { TrialPhase::Running } else { TrialPhase::Stopped };
    let data_rate = DataRate::from_hertz(words.next_word()?)?;
    let settings = Settings { data_rate, gain: Gain::from_factor(gain)? };
    let first = SampleIndex::new(words.next_word()?);
    let mut counts = [0; 6];
    for count in &mut counts {
        *count = words.next_word()?;
    }
    let [offered, taken, saturated, repeated, contradictory, unattended] = counts;
    let counts = Counts { offered, taken, saturated, repeated, contradictory, unattended };
    (2..=3).contains(&rank).then_some(Standing { phase, rank, settings, first, counts, by_button })
}

#[cfg(test)]
mod tests;
