//! Acquisition: a converter that is started, watched and, when it fails, started again.
//!
//! Nothing here waits for the converter. It announces its conversions; when it does not for `OVERDUE_PERIODS`, it counts as
//! silent, and produces no sample until it is heard again. When it is silent for longer, or when eight replies in a row are
//! corrupted, it is started anew, twice a second. Conversions that passed meanwhile are lost, and counted when the next one comes: the
//! numbers of samples go on as if each had been read.
//!
//! # A converter that repeats itself, or answers late
//!
//! A conversion whose codes are all those of the one before, bit by bit, is no conversion, whatever its data-ready bits say. It may
//! be chance, where there are few gages; it may be the first reply of a converter that from now on answers one frame late,
//! with codes that look as good as any. So it is thrown away, and with it every other until the converter has said who it is in
//! the frame in which it must. It is asked so every `QUESTION_MICROS` besides, for whatever is not told by a repetition.

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::SpiDevice;
use ftcal_shared::fault::AdcFault;
use ftcal_shared::units::{AdcCode, DeviceTime, SampleIndex};
use ftcal_shared::wire::AdcState;

use crate::adc::{Ads131m08, ChannelMask, Input, Status};
use crate::handover::{Orders, Reading, Report};
use crate::health::{Injector, InputWatch, is_disturbance};
use crate::tunnel::{ANSWER_MICROS, UNHANDLED_MICROS};

/// Conversion periods without data-ready after which the converter counts as silent.
const OVERDUE_PERIODS: u64 = 2;

/// The shortest silence that counts: on the board a few ticks; in the emulator what its serial tunnel may take.
const LEAST_OVERDUE_MICROS: u64 = if cfg!(feature = "emulated") { LEAST_SILENCE_MICROS } else { 4_000 };

/// Conversion periods without data-ready after which the converter is started anew, and the least of such a silence.
const SILENCE_PERIODS: u64 = 10;
const LEAST_SILENCE_MICROS: u64 =
    if cfg!(feature = "emulated") { ANSWER_MICROS + UNHANDLED_MICROS + 100_000 } else { 100_000 };

/// Between two questions who the converter is.
const QUESTION_MICROS: u32 = 8_000;

/// Corrupted replies in a row after which the bus counts as broken rather than disturbed.
const LARGEST_CORRUPTED_RUN: u8 = 8;

/// Time from the end of an attempt to start a faulty converter to the next.
const RESTART_INTERVAL_MICROS: u64 = 500_000;

/// Conversions that are left of the range of a count that is about to begin at zero again.
const BEFORE_ZERO: u32 = 10_000;

/// One conversion of the gages in use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample<const GAGES: usize> {
    /// The codes, one a gage.
    pub codes: [AdcCode; GAGES],
    /// Gages that repeat their code as no live input does: bit k for gage k.
    pub repeating: u16,
    /// Conversions are missing between the sample before and this one.
    pub after_gap: bool,
}

/// Counts of conversions since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ConversionCounters {
    /// Read well.
    pub read: u32,
    /// Due but never announced, or announced and not read in time.
    pub lost: u32,
    /// Thrown away for a wrong checksum or a reply that makes no sense.
    pub corrupted: u32,
    /// Read, and thrown away because what was read before was not worked off yet.
    pub overrun: u32,
}

/// When the converter was started last, whether that went well or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LastStart {
    /// Not since it was ordered.
    Never,
    SinceLastTick,
    EndedBefore(DeviceTime),
}

/// The converter on its bus, with `GAGES` of its channels in use.
pub struct Acquisition<Spi, const GAGES: usize> {
    adc: Ads131m08<Injector<Spi>>,
    inputs: InputWatch<GAGES>,
    orders: Orders,
    state: AdcState,
    counters: ConversionCounters,
    next_index: SampleIndex,
    last_start: LastStart,
    /// When the last conversion since the start was read, or waiting for the first began.
    last_read: Option<DeviceTime>,
    /// When the last conversion was announced, since the converter was last ordered to start.
    last_announced: Option<DeviceTime>,
    /// The converter fell silent, and has not been heard since, restarted or not.
    silent: bool,
    corrupted_run: u8,
    /// Conversions until the converter is asked who it is.
    until_question: u32,
    /// It has repeated itself, and not said who it is since.
    in_doubt: bool,
    /// Conversions were lost or thrown away since the last sample.
    after_gap: bool,
    /// What was read last: made where it stands, and copied once, into the queue.
    reading: Reading<GAGES>,
}

impl<Spi: SpiDevice<u8>, const GAGES: usize> Acquisition<Spi, GAGES> {
    /// Gage k is on channel k.
    const CHANNELS: ChannelMask = ChannelMask::first(GAGES);

    /// A converter that is not started yet; the first [`Acquisition::tick`] starts it.
    pub fn new(spi: Spi) -> Self {
        Self {
            adc: Ads131m08::new(Injector::new(spi)),
            inputs: InputWatch::new(),
            orders: Orders::new(Self::CHANNELS),
            state: AdcState::Starting,
            counters: ConversionCounters::default(),
            next_index: SampleIndex::default(),
            last_start: LastStart::Never,
            last_read: None,
            last_announced: None,
            silent: false,
            corrupted_run: 0,
            until_question: 0,
            in_doubt: false,
            after_gap: false,
            reading: Reading::NONE,
        }
    }

    /// Goes on counting as one that has run for so long that its counts are about to begin at zero again: for tests of what happens then.
    pub fn count_on(&mut self) {
        let almost = u32::MAX - BEFORE_ZERO;
        self.counters = ConversionCounters {
            read: almost,
            lost: u32::MAX - 3,
            corrupted: u32::MAX - 1,
            overrun: u32::MAX,
        };
        self.next_index = SampleIndex::new(almost);
    }

    /// State of the converter. One that fell silent stays at fault until a conversion has come: that it could be set up
    /// again does not say that it converts.
    pub const fn state(&self) -> AdcState {
        match self.state {
            AdcState::Running if self.silent => AdcState::Faulty(AdcFault::DataReadyLost),
            state => state,
        }
    }

    /// Does from now on as ordered, and reports. Where a start was ordered, the next [`Acquisition::tick`] makes it.
    pub(crate) fn follow(&mut self, orders: Orders) -> Report {
        if orders.injection != self.orders.injection {
            self.adc.bus_mut().play(orders.injection);
        }
        if orders.start != self.orders.start {
            self.state = AdcState::Starting;
            self.silent = false;
            self.last_start = LastStart::Never;
            if self.last_announced.take().is_some() {
                // What passes until it runs again was not to be read: it is a gap, but no loss.
                self.next_index = self.next_index.next();
            }
        }
        self.orders = orders;
        Report { state: self.state(), counters: self.counters, next_index: self.next_index }
    }

    /// Notes that the last reading found no room, and is lost.
    pub const fn note_overrun(&mut self) {
        self.counters.overrun = self.counters.overrun.wrapping_add(1);
        self.after_gap = true;
    }

    /// Watches the converter and starts it where it is due. Takes some milliseconds when it starts the converter, during
    /// which there are no samples to miss; otherwise a few instructions.
    pub fn tick(&mut self, now: DeviceTime, delay: &mut impl DelayNs) {
        if self.last_start == LastStart::SinceLastTick {
            self.last_start = LastStart::EndedBefore(now);
        }
        match self.state {
            AdcState::Running => self.check_silence(now),
            AdcState::Starting | AdcState::Faulty(_) => {
                let is_due = match self.last_start {
                    LastStart::Never => true,
                    LastStart::SinceLastTick => false,
                    LastStart::EndedBefore(tick) => micros_since(now, tick) >= RESTART_INTERVAL_MICROS,
                };
                if is_due {
                    self.start(delay);
                }
            }
        }
    }

    /// Reads the conversion that the converter announced. `None` where the converter is not running.
    ///
    /// `announced` is when data-ready fell, as exactly as the board can tell, and becomes the sample's time; `now` is the
    /// board's clock. (In the emulator the converter lives outside and announces by its own clock.)
    ///
    /// Where the reading bears a fault, this conversion is unusable. One disturbed reply is counted and forgiven; the state turns to
    /// [`AdcState::Faulty`] as described above.
    pub fn on_data_ready(&mut self, now: DeviceTime, announced: DeviceTime) -> Option<&Reading<GAGES>> {
        if self.state != AdcState::Running || self.orders.ignore_data_ready {
            return None;
        }
        let fault = self.read(announced).err();
        self.last_read = Some(now);
        self.last_announced = Some(announced);
        let index = self.next_index;
        self.next_index = index.next();
        if let Some(fault) = fault {
            self.after_gap = true;
            self.counters.corrupted = self.counters.corrupted.wrapping_add(1);
            self.corrupted_run += 1;
            if !is_disturbance(fault) || self.corrupted_run >= LARGEST_CORRUPTED_RUN {
                self.state = AdcState::Faulty(fault);
            }
        } else {
            self.corrupted_run = 0;
            self.silent = false;
            self.counters.read = self.counters.read.wrapping_add(1);
            self.reading.sample.after_gap = core::mem::take(&mut self.after_gap);
        }
        let reading = &mut self.reading;
        (reading.fault, reading.index, reading.era) = (fault, index, self.orders.era);
        (reading.announced, reading.read_at) = (announced, now);
        Some(reading)
    }

    /// Reads the newest conversion, and which gages repeat themselves. The converter keeps up to two conversions for a reader that is
    /// late. After a pause, or where a read has failed, the older one is passed over, or every sample from then on would be one
    /// conversion old.
    fn read(&mut self, announced: DeviceTime) -> Result<(), AdcFault> {
        self.reading.sample.repeating = 0;
        let is_late = self.count_lost_before(announced) > 0;
        self.after_gap |= is_late;
        // A frame that was not read well may have left in the converter what it was to carry.
        let may_lag = self.corrupted_run > 0 && !self.in_doubt;
        if is_late || may_lag {
            self.read_past_backlog()?;
        } else {
            let ask = self.is_to_be_asked();
            match self.adc.read_codes(ask, &mut self.reading.sample.codes)? {
                // It was asked who it is, and has said so in time.
                None => self.in_doubt = false,
                Some(status) if !Self::is_new(status) => return Err(AdcFault::StaleConversion),
                Some(_) => {}
            }
        }
        if self.orders.settings.input != Input::Pins {
            // The converter's own signals are as still as they are.
            return Ok(());
        }
        let repetition = self.inputs.push(&self.reading.sample.codes);
        if repetition.of_all {
            self.in_doubt = true;
            self.until_question = 0;
        }
        self.reading.sample.repeating = repetition.lasting;
        if self.in_doubt { Err(AdcFault::StaleConversion) } else { Ok(()) }
    }

    /// The newer of what the converter keeps: the second frame where that is new, else the first.
    #[cold]
    fn read_past_backlog(&mut self) -> Result<(), AdcFault> {
        let first = self.adc.read_codes(false, &mut self.reading.sample.codes)?;
        if first.is_none() {
            // It was asked who it is, and has said so in time.
            self.in_doubt = false;
        }
        let mut newer = [AdcCode::ZERO; GAGES];
        let second = self.adc.read_codes(false, &mut newer)?;
        if second.is_some_and(Self::is_new) {
            self.reading.sample.codes = newer;
            Ok(())
        } else if first.is_none_or(Self::is_new) {
            Ok(())
        } else {
            Err(AdcFault::StaleConversion)
        }
    }

    /// Without its data-ready bit a code is the one before, once more.
    fn is_new(status: Status) -> bool {
        status.data_ready().contains(Self::CHANNELS)
    }

    /// Whether the converter is to be asked now who it is.
    fn is_to_be_asked(&mut self) -> bool {
        if let Some(left) = self.until_question.checked_sub(1) {
            self.until_question = left;
            return false;
        }
        // This one counts; and at the lowest rate, too, the converter is to have a word about itself in between.
        let period = self.orders.settings.data_rate.hertz() / (1_000_000 / QUESTION_MICROS);
        self.until_question = period.saturating_sub(1).max(1);
        true
    }

    fn start(&mut self, delay: &mut impl DelayNs) {
        self.last_start = LastStart::SinceLastTick;
        self.last_read = None;
        self.corrupted_run = 0;
        self.in_doubt = false;
        self.after_gap = true;
        self.inputs.restart();
        self.state = match self.adc.start(delay, self.orders.settings) {
            Ok(()) => AdcState::Running,
            Err(fault) => AdcState::Faulty(fault),
        };
    }

    fn check_silence(&mut self, now: DeviceTime) {
        let period = self.period_nanos();
        // Starting takes its time, so before the first conversion the silence counts from the first look after it.
        let last = *self.last_read.get_or_insert(now);
        let silence = micros_since(now, last);
        if silence > (OVERDUE_PERIODS * period / 1000).max(LEAST_OVERDUE_MICROS) {
            self.silent = true;
        }
        if silence > (SILENCE_PERIODS * period / 1000).max(LEAST_SILENCE_MICROS) {
            self.state = AdcState::Faulty(AdcFault::DataReadyLost);
        }
    }

    /// Whole periods that passed without data-ready are conversions lost. Between two conversions in order lies one
    /// period, give or take the time to respond; only a pause of more than one and a half says that one is missing.
    fn count_lost_before(&mut self, announced: DeviceTime) -> u32 {
        let Some(last) = self.last_announced else { return 0 };
        let period = self.period_nanos();
        let since_half_before = micros_since(announced, last).saturating_mul(1000) + period / 2;
        // As is usual; it costs no division.
        if since_half_before < 2 * period {
            return 0;
        }
        let periods = since_half_before / period;
        let missing = u32::try_from(periods.saturating_sub(1)).unwrap_or(u32::MAX);
        self.counters.lost = self.counters.lost.wrapping_add(missing);
        self.next_index = SampleIndex::new(self.next_index.get().wrapping_add(missing));
        missing
    }

    /// Exact at every rate of the converter.
    fn period_nanos(&self) -> u64 {
        u64::from(1_000_000_000 / self.orders.settings.data_rate.hertz())
    }
}

const fn micros_since(now: DeviceTime, earlier: DeviceTime) -> u64 {
    now.as_micros().saturating_sub(earlier.as_micros())
}
