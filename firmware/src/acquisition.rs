//! Acquisition: a converter that is started, watched and, when it fails, started again.
//!
//! Nothing here waits for the converter. It announces its conversions; when it does not for `OVERDUE_PERIODS`, it counts as
//! silent, and produces no sample until it is heard again. When it is silent for longer, or when eight replies in a row are
//! corrupted, it is started anew, twice a second.
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

use crate::adc::{Ads131m08, CHANNELS, ChannelMask, Input};
use crate::handover::{Orders, Reading, Report};
use crate::health::{Injector, InputWatch, is_disturbance};

/// Conversion periods without data-ready after which the converter counts as silent.
const OVERDUE_PERIODS: u64 = 2;

/// The shortest silence that counts: on the board a few ticks; in the emulator what its serial tunnel may take.
const LEAST_OVERDUE_MICROS: u64 = if cfg!(feature = "emulated") { LEAST_SILENCE_MICROS } else { 4_000 };

/// Conversion periods without data-ready after which the converter is started anew, and the least of such a silence.
const SILENCE_PERIODS: u64 = 10;
const LEAST_SILENCE_MICROS: u64 = 100_000;

/// Between two questions who the converter is.
const QUESTION_MICROS: u32 = 8_000;

/// Corrupted replies in a row after which the bus counts as broken rather than disturbed.
const LARGEST_CORRUPTED_RUN: u8 = 8;

/// Time between two attempts to start a faulty converter.
const RESTART_INTERVAL_MICROS: u64 = 500_000;

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

/// The converter on its bus, with `GAGES` of its channels in use.
pub struct Acquisition<Spi, const GAGES: usize> {
    adc: Ads131m08<Injector<Spi>>,
    inputs: InputWatch<GAGES>,
    orders: Orders,
    state: AdcState,
    counters: ConversionCounters,
    next_index: SampleIndex,
    last_start: Option<DeviceTime>,
    /// When the last conversion since the start was read, or waiting for the first began.
    last_read: Option<DeviceTime>,
    /// When the last conversion since the start was announced.
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
            last_start: None,
            last_read: None,
            last_announced: None,
            silent: false,
            corrupted_run: 0,
            until_question: 0,
            in_doubt: false,
            after_gap: false,
        }
    }

    /// State of the converter. One that fell silent stays at fault until a conversion has come: that it could be set up
    /// again does not say that it converts.
    pub const fn state(&self) -> AdcState {
        match self.state {
            AdcState::Running if self.silent => AdcState::Faulty(AdcFault::DataReadyLost),
            state => state,
        }
    }

    /// Does from now on as ordered, and reports. A new era begins with a start of the converter, at the next [`Acquisition::tick`].
    pub(crate) fn follow(&mut self, orders: Orders) -> Report {
        if orders.injection != self.orders.injection {
            self.adc.bus_mut().play(orders.injection);
        }
        if orders.era != self.orders.era {
            self.state = AdcState::Starting;
            self.silent = false;
            self.last_start = None;
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
        match self.state {
            AdcState::Running => self.check_silence(now),
            AdcState::Starting | AdcState::Faulty(_) => {
                let due =
                    self.last_start.is_none_or(|last| micros_since(now, last) >= RESTART_INTERVAL_MICROS);
                if due {
                    self.start(now, delay);
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
    pub fn on_data_ready(&mut self, now: DeviceTime, announced: DeviceTime) -> Option<Reading<GAGES>> {
        if self.state != AdcState::Running || self.orders.ignore_data_ready {
            return None;
        }
        let mut reading = Reading::new(announced, now, self.orders.era);
        let fault = self.read(announced, &mut reading.sample).err();
        self.last_read = Some(now);
        self.last_announced = Some(announced);
        reading.index = self.next_index;
        self.next_index = reading.index.next();
        reading.fault = fault;
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
            reading.sample.after_gap = core::mem::take(&mut self.after_gap);
        }
        Some(reading)
    }

    /// Reads the newest conversion, and which gages repeat themselves. The converter keeps up to two conversions for a reader that is
    /// late; after a pause the older one is thrown away, or every sample from then on would be one conversion old.
    fn read(&mut self, announced: DeviceTime, sample: &mut Sample<GAGES>) -> Result<(), AdcFault> {
        let mut codes = [AdcCode::ZERO; CHANNELS];
        if self.count_lost_before(announced) > 0 {
            self.after_gap = true;
            self.adc.read_codes(false, &mut codes)?;
        }
        let ask = self.is_to_be_asked();
        match self.adc.read_codes(ask, &mut codes)? {
            // It was asked who it is, and has said so in time.
            None => self.in_doubt = false,
            // Without its data-ready bit a code is the one before, once more.
            Some(status) if !status.data_ready().contains(Self::CHANNELS) => {
                return Err(AdcFault::StaleConversion);
            }
            Some(_) => {}
        }
        for (code, read) in sample.codes.iter_mut().zip(&codes) {
            *code = *read;
        }
        if self.orders.settings.input != Input::Pins {
            // The converter's own signals are as still as they are.
            return Ok(());
        }
        let repetition = self.inputs.push(&sample.codes);
        if repetition.of_all {
            self.in_doubt = true;
            self.until_question = 0;
        }
        sample.repeating = repetition.lasting;
        if self.in_doubt { Err(AdcFault::StaleConversion) } else { Ok(()) }
    }

    /// Whether the converter is to be asked now who it is.
    fn is_to_be_asked(&mut self) -> bool {
        if let Some(left) = self.until_question.checked_sub(1) {
            self.until_question = left;
            return false;
        }
        self.until_question = (self.orders.settings.data_rate.hertz() / (1_000_000 / QUESTION_MICROS)).max(1);
        true
    }

    fn start(&mut self, now: DeviceTime, delay: &mut impl DelayNs) {
        self.last_start = Some(now);
        self.last_read = None;
        self.last_announced = None;
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
        let period = self.period_micros();
        // Starting takes its time, so before the first conversion the silence counts from the first look after it.
        let last = *self.last_read.get_or_insert(now);
        let silence = micros_since(now, last);
        if silence > (OVERDUE_PERIODS * period).max(LEAST_OVERDUE_MICROS) {
            self.silent = true;
        }
        if silence > (SILENCE_PERIODS * period).max(LEAST_SILENCE_MICROS) {
            self.state = AdcState::Faulty(AdcFault::DataReadyLost);
        }
    }

    /// Whole periods that passed without data-ready are conversions lost. Between two conversions in order lies one
    /// period, give or take the time to respond; only a pause of more than one and a half says that one is missing.
    fn count_lost_before(&mut self, announced: DeviceTime) -> u32 {
        let Some(last) = self.last_announced else { return 0 };
        let period = self.period_micros();
        let periods = (micros_since(announced, last) + period / 2) / period;
        let missing = u32::try_from(periods.saturating_sub(1)).unwrap_or(u32::MAX);
        self.counters.lost = self.counters.lost.wrapping_add(missing);
        self.next_index = SampleIndex::new(self.next_index.get().wrapping_add(missing));
        missing
    }

    fn period_micros(&self) -> u64 {
        1_000_000 / u64::from(self.orders.settings.data_rate.hertz())
    }
}

const fn micros_since(now: DeviceTime, earlier: DeviceTime) -> u64 {
    now.as_micros().saturating_sub(earlier.as_micros())
}
