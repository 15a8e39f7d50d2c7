//! The memory: items into the flash and out of it, one at a time, each read back after it was written.

use core::task::Poll;

use embassy_futures::poll_once;
use embedded_storage::nor_flash::NorFlash;
use ftcal_shared::wire::{Identity, KeptCalibration, KeptCalibrations};
use sequential_storage::cache::Cache;
use sequential_storage::cache::key_pointers::ArrayKeyPointers;
use sequential_storage::cache::page_pointers::ArrayPagePointers;
use sequential_storage::cache::page_states::ArrayPageStates;
use sequential_storage::map::{MapConfig, MapStorage};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::items::{Counters, Entry, Item, Name, Roster, Settings, Slot, StoredCalibration};
use super::pages::{PAGE, Pages, PagesError};
use super::record::{KEYS, Key, LONGEST, Missing, decode, encode};
use crate::health::{KeptHealth, KeptPeaks};

/// Room for the longest record and its key.
const ROOM: usize = LONGEST + 8;

/// Where things are, which spares looking through a whole sector for each.
type Places = Cache<ArrayPageStates<2>, ArrayPagePointers<2>, ArrayKeyPointers<u8, KEYS>, u8>;

type Map<'flash, Flash> = MapStorage<u8, Pages<'flash, Flash>, Places>;

/// Why something is not kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(target_os = "none", derive(defmt::Format))]
pub enum StorageError {
    /// The flash reports an error, or what is in it makes no sense.
    Flash,
    /// What was read back is not what was written.
    ReadBackDiffers,
    /// There is no room, in a record or in the flash.
    NoRoom,
    /// No calibration of this identity is kept.
    NoSuchCalibration,
}

/// What was kept across the reset.
#[derive(Clone, Debug, PartialEq)]
pub struct Kept {
    /// The calibration to be used.
    pub calibration: Option<StoredCalibration>,
    /// Which there are, and why there is none.
    pub calibrations: KeptCalibrations,
    /// How the converter is to be set; `None` where that was never stored.
    pub settings: Option<Settings>,
    /// Limits and tare; `None` where they were never stored.
    pub health: Option<KeptHealth>,
    /// Peaks of the load; `None` where they were never stored.
    pub peaks: Option<KeptPeaks>,
    /// Something that was stored besides the calibrations cannot be read.
    pub is_incomplete: bool,
    /// Name and counters.
    pub identity: Identity,
}

/// Calibrations, settings, name and counters, in a flash of four sectors; see [`super`].
#[derive(Debug)]
pub struct Memory<Flash> {
    flash: Flash,
    /// Absent before the first look into the flash, and after one that failed: the flash may then be in any state.
    places: Option<Places>,
}

impl<Flash: NorFlash> Memory<Flash> {
    /// A memory in this flash.
    pub const fn new(flash: Flash) -> Self {
        Self { flash, places: None }
    }

    /// The flash.
    pub const fn flash(&mut self) -> &mut Flash {
        &mut self.flash
    }

    /// Counts a start, and reads what was kept, after what a power cut has interrupted is brought to its end. A start that cannot be
    /// counted is a start all the same.
    ///
    /// # Errors
    ///
    /// [`StorageError::Flash`].
    pub fn start(&mut self) -> Result<Kept, StorageError> {
        let mut found = self.survey()?;
        let mut counters = found.counters.unwrap_or_default();
        counters.boots = counters.boots.saturating_add(1);
        let _ = self.append(&counters);
        let is_incomplete = found.is_incomplete();
        found.counters = Ok(counters);
        let kept = self.kept(found)?;
        Ok(Kept { is_incomplete, ..kept })
    }

    /// Reads what is kept.
    ///
    /// # Errors
    ///
    /// [`StorageError::Flash`].
    pub fn read(&mut self) -> Result<Kept, StorageError> {
        let found = Found {
            rosters: [self.get(Key::Roster, Roster::FORMAT)?, self.get(Key::RosterCopy, Roster::FORMAT)?],
            settings: self.load()?,
            health: self.load()?,
            peaks: self.load()?,
            name: self.load()?,
            counters: self.load()?,
        };
        self.kept(found)
    }

    fn kept(&mut self, found: Found) -> Result<Kept, StorageError> {
        let is_incomplete = found.is_incomplete();
        let Found { rosters, settings, health, peaks, name, counters } = found;
        let (Name(name), Counters { boots, stores }) =
            (name.unwrap_or_default(), counters.unwrap_or_default());
        let roster = newest(rosters);
        let mut calibrations = KeptCalibrations {
            current: KeptCalibration::Nothing,
            previous: roster.ok().and_then(|roster| roster.previous).map(|entry| entry.identity),
        };
        let mut calibration = None;
        match roster.map(|roster| roster.current) {
            Err(missing) => calibrations.current = as_told(missing),
            Ok(None) => {}
            Ok(Some(entry)) => match self.calibration(entry)? {
                Err(missing) => calibrations.current = as_told(missing),
                Ok(stored) => {
                    calibrations.current = KeptCalibration::Calibration(entry.identity);
                    calibration = Some(stored);
                }
            },
        }
        Ok(Kept {
            calibration,
            calibrations,
            settings: settings.ok(),
            health: health.ok(),
            peaks: peaks.ok(),
            is_incomplete,
            identity: Identity { name, boots, stores },
        })
    }

    /// All but the calibrations, in one look through the flash instead of one for each.
    fn survey(&mut self) -> Result<Found, StorageError> {
        let mut room = [0; ROOM];
        let mut found = Found::default();
        self.with_map(|map| {
            at_once(async {
                let mut items = map.fetch_all_items(&mut room).await?;
                // The newest of a key comes last.
                while let Some((key, record)) = items.next::<&[u8]>(&mut room).await? {
                    found.note(key, record);
                }
                Ok(())
            })
        })?;
        Ok(found)
    }

    /// Makes this calibration the current one, and the one that was current the previous. Storing the one that is current
    /// changes nothing.
    ///
    /// # Errors
    ///
    /// [`StorageError`]; after which the current calibration is the one that was, or this one.
    pub fn store_calibration(&mut self, new: &StoredCalibration) -> Result<(), StorageError> {
        let roster = self.roster()?.unwrap_or_default();
        let mut previous = roster.previous;
        if let Some(entry) = roster.current
            && let Ok(current) = self.calibration(entry)?
        {
            if current == *new {
                return Ok(());
            }
            previous = Some(entry);
        }
        let taken = [roster.current, roster.previous].map(|entry| entry.map(|entry| entry.slot));
        let slot = Slot::ALL.into_iter().find(|slot| !taken.contains(&Some(*slot))).unwrap_or(Slot::A);
        self.put(slot.key(), StoredCalibration::FORMAT, new)?;
        let current = Some(Entry { slot, identity: new.upload.identity });
        self.put_roster(Roster { number: roster.number.wrapping_add(1), current, previous })
    }

    /// Makes the previous calibration the current one, and the other way round, if its identity is this. Where the current one
    /// has it, nothing changes: this may be done twice.
    ///
    /// # Errors
    ///
    /// [`StorageError`]; after which the current calibration is the one that was, or that of this identity.
    pub fn roll_back(&mut self, to: u32) -> Result<(), StorageError> {
        let roster = self.roster()?.unwrap_or_default();
        let is_wanted = |entry: &Entry| entry.identity == to;
        if let Some(entry) = roster.current.filter(is_wanted)
            && self.calibration(entry)?.is_ok()
        {
            return Ok(());
        }
        let entry = roster.previous.filter(is_wanted).ok_or(StorageError::NoSuchCalibration)?;
        self.calibration(entry)?.map_err(|_| StorageError::NoSuchCalibration)?;
        let number = roster.number.wrapping_add(1);
        self.put_roster(Roster { number, current: Some(entry), previous: roster.current })
    }

    /// Keeps an item; the one before it is forgotten. Keeping what is kept already changes nothing.
    ///
    /// # Errors
    ///
    /// [`StorageError`]; after which the item that was is kept, or this one.
    pub fn store<Kind: Item>(&mut self, item: &Kind) -> Result<(), StorageError> {
        if self.load()?.as_ref() == Ok(item) { Ok(()) } else { self.append(item) }
    }

    /// The item as it was stored last.
    ///
    /// # Errors
    ///
    /// [`StorageError::Flash`].
    pub fn load<Kind: Item>(&mut self) -> Result<Result<Kind, Missing>, StorageError> {
        self.get(Kind::KEY.0, Kind::FORMAT)
    }

    fn roster(&mut self) -> Result<Result<Roster, Missing>, StorageError> {
        let one = self.get(Key::Roster, Roster::FORMAT)?;
        Ok(newest([one, self.get(Key::RosterCopy, Roster::FORMAT)?]))
    }

    /// The one instant at which one calibration gives way to another is within the first of these two.
    fn put_roster(&mut self, roster: Roster) -> Result<(), StorageError> {
        self.put(Key::Roster, Roster::FORMAT, &roster)?;
        self.put(Key::RosterCopy, Roster::FORMAT, &roster)?;
        let counters: Counters = self.load()?.unwrap_or_default();
        self.append(&Counters { stores: counters.stores.saturating_add(1), ..counters })
    }

    /// The calibration that the roster names: another one in its place, or none, is a corrupt one.
    fn calibration(&mut self, entry: Entry) -> Result<Result<StoredCalibration, Missing>, StorageError> {
        let found: Result<StoredCalibration, Missing> =
            self.get(entry.slot.key(), StoredCalibration::FORMAT)?;
        Ok(match found {
            Ok(stored) if is_whole(&stored, entry.identity) => Ok(stored),
            Ok(_) | Err(Missing::Nothing) => Err(Missing::Corrupt),
            Err(missing) => Err(missing),
        })
    }

    fn get<Value: DeserializeOwned>(
        &mut self,
        key: Key,
        format: u8,
    ) -> Result<Result<Value, Missing>, StorageError> {
        let mut room = [0; ROOM];
        Ok(match self.find(key, &mut room)? {
            None => Err(Missing::Nothing),
            Some(record) => decode(key, format, record),
        })
    }

    /// Keeps an item that is not what is kept already.
    fn append<Kind: Item>(&mut self, item: &Kind) -> Result<(), StorageError> {
        self.put(Kind::KEY.0, Kind::FORMAT, item)
    }

    fn put(&mut self, key: Key, format: u8, item: &impl Serialize) -> Result<(), StorageError> {
        let mut record = [0; LONGEST];
        let length = encode(key, format, item, &mut record).ok_or(StorageError::NoRoom)?;
        self.write(key, record.get(..length).ok_or(StorageError::NoRoom)?)
    }

    /// Writes a record and reads it back.
    #[inline(never)]
    fn write(&mut self, key: Key, record: &[u8]) -> Result<(), StorageError> {
        let mut room = [0; ROOM];
        self.with_map(|map| at_once(map.store_item(&mut room, &(key as u8), &record)))?;
        if self.find(key, &mut room)? == Some(record) { Ok(()) } else { Err(StorageError::ReadBackDiffers) }
    }

    #[inline(never)]
    fn find<'room>(
        &mut self,
        key: Key,
        room: &'room mut [u8; ROOM],
    ) -> Result<Option<&'room [u8]>, StorageError> {
        self.with_map(|map| at_once(map.fetch_item(room, &(key as u8))))
    }

    /// Does something with the map over both pages. Before the first time, and after each that failed, what is unfinished is brought
    /// to its end.
    fn with_map<Value>(
        &mut self,
        act: impl FnOnce(&mut Map<'_, Flash>) -> Result<Value, StorageError>,
    ) -> Result<Value, StorageError> {
        let places = if let Some(places) = self.places.take() {
            places
        } else {
            Pages::new(&mut self.flash).recover().map_err(|_| StorageError::Flash)?;
            Cache::new(ArrayPageStates::new(), ArrayPagePointers::new(), ArrayKeyPointers::new())
        };
        let config = const { MapConfig::new(0..2 * PAGE) };
        let mut map = MapStorage::new(Pages::new(&mut self.flash), config, places);
        let outcome = act(&mut map);
        let (_, places) = map.destroy();
        self.places = outcome.is_ok().then_some(places);
        outcome
    }
}

/// What is kept besides the calibrations.
struct Found {
    rosters: [Result<Roster, Missing>; 2],
    settings: Result<Settings, Missing>,
    health: Result<KeptHealth, Missing>,
    peaks: Result<KeptPeaks, Missing>,
    name: Result<Name, Missing>,
    counters: Result<Counters, Missing>,
}

impl Default for Found {
    fn default() -> Self {
        let nothing = Missing::Nothing;
        Self {
            rosters: [Err(nothing); 2],
            settings: Err(nothing),
            health: Err(nothing),
            peaks: Err(nothing),
            name: Err(nothing),
            counters: Err(nothing),
        }
    }
}

impl Found {
    /// Notes a record if it is one of these.
    fn note(&mut self, key: u8, record: &[u8]) {
        if key == Key::Roster as u8 {
            self.rosters[0] = decode(Key::Roster, Roster::FORMAT, record);
        } else if key == Key::RosterCopy as u8 {
            self.rosters[1] = decode(Key::RosterCopy, Roster::FORMAT, record);
        } else if key == Key::Settings as u8 {
            self.settings = decode(Key::Settings, Settings::FORMAT, record);
        } else if key == Key::Health as u8 {
            self.health = decode(Key::Health, KeptHealth::FORMAT, record);
        } else if key == Key::Peaks as u8 {
            self.peaks = decode(Key::Peaks, KeptPeaks::FORMAT, record);
        } else if key == Key::Name as u8 {
            self.name = decode(Key::Name, Name::FORMAT, record);
        } else if key == Key::Counters as u8 {
            self.counters = decode(Key::Counters, Counters::FORMAT, record);
        }
    }

    /// Whether one of these was stored and cannot be read.
    fn is_incomplete(&self) -> bool {
        const fn is_lost<Kind>(found: &Result<Kind, Missing>) -> bool {
            matches!(found, Err(Missing::Corrupt | Missing::OtherFormat(_)))
        }
        is_lost(&self.settings)
            || is_lost(&self.health)
            || is_lost(&self.peaks)
            || is_lost(&self.name)
            || is_lost(&self.counters)
    }
}

/// The newest of the two copies of the roster. Where one is lost, the other still tells.
fn newest(rosters: [Result<Roster, Missing>; 2]) -> Result<Roster, Missing> {
    match rosters {
        [Ok(one), Ok(other)] if other.number.wrapping_sub(one.number).cast_signed() > 0 => Ok(other),
        [Ok(roster), _] | [Err(_), Ok(roster)] => Ok(roster),
        [Err(Missing::Nothing), missing @ Err(_)] | [missing @ Err(_), Err(_)] => missing,
    }
}

/// The outcome of a future that is ready at once, as all are whose flash blocks.
fn at_once<Value>(
    future: impl Future<Output = Result<Value, sequential_storage::Error<PagesError>>>,
) -> Result<Value, StorageError> {
    match poll_once(future) {
        Poll::Ready(Ok(value)) => Ok(value),
        Poll::Ready(Err(sequential_storage::Error::FullStorage)) => Err(StorageError::NoRoom),
        Poll::Ready(Err(_)) | Poll::Pending => Err(StorageError::Flash),
    }
}

fn is_whole(stored: &StoredCalibration, identity: u32) -> bool {
    stored.upload.identity == identity && stored.upload.identity_of_numbers() == identity
}

const fn as_told(missing: Missing) -> KeptCalibration {
    match missing {
        Missing::Nothing => KeptCalibration::Nothing,
        Missing::Corrupt => KeptCalibration::Corrupt,
        Missing::OtherFormat(format) => KeptCalibration::OtherFormat(format),
    }
}
