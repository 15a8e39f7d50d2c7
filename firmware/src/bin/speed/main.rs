//! What the estimator costs on the target, in instructions. For the emulator: `tests/speed` builds and runs it.
//!
//! Run with `-icount shift=0`, the emulator's clock advances by one nanosecond an instruction, so that SysTick counts
//! instructions, repeatably. Its rate is measured first, with a loop of known length. One line a quantity goes out by
//! semihosting: a name and a number.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    eprintln!("This runs in the emulator: tests/speed.");
    std::process::ExitCode::from(2)
}

#[cfg(target_os = "none")]
#[path = "."]
mod target {
    mod converter;
    mod path;

    use core::hint::black_box;
    use core::panic::PanicInfo;

    use cortex_m::asm;
    use cortex_m::peripheral::SYST;
    use cortex_m::peripheral::syst::SystClkSource;
    use cortex_m_rt::entry;
    use cortex_m_semihosting::{debug, hprintln};
    use defmt_rtt as _;
    use ftcal_firmware::acquisition::Sample;
    use ftcal_firmware::health::Health;
    use ftcal_shared::estimation::application::RealTimeCalibration;
    use ftcal_shared::estimation::bins::Bins;
    use ftcal_shared::estimation::expectation::Expectation;
    use ftcal_shared::estimation::gate::Gate;
    use ftcal_shared::estimation::moments::{BLOCK, Moments, higher_moment_count};
    use ftcal_shared::estimation::parity::ParitySpace;
    use ftcal_shared::units::{AdcCode, DataRate, Dof, Rank};
    // The interrupt table comes with the device.
    use stm32f4xx_hal as _;

    const GAGES: usize = 8;
    const HIGHER: usize = higher_moment_count(GAGES);

    /// Samples of the trial: two whole blocks of the sums, so that bringing them into the long sums is counted, too.
    #[expect(clippy::cast_possible_truncation, reason = "some thousands")]
    const SAMPLES: u32 = 2 * BLOCK as u32;

    /// Samples through the gate: many blocks of it.
    const GATED: u32 = 4000;

    /// Instructions of the loop that measures SysTick's rate: two a turn.
    const RATE_INSTRUCTIONS: u32 = 1_000_000;

    /// SysTick counts down from here.
    const RELOAD: u32 = 0x00ff_ffff;

    #[panic_handler]
    fn panic(information: &PanicInfo<'_>) -> ! {
        hprintln!("{}", information);
        debug::exit(debug::EXIT_FAILURE);
        loop {
            asm::bkpt();
        }
    }

    /// How many instructions one tick of SysTick is; the timer runs for good.
    struct Counter {
        instructions_per_tick: f64,
    }

    impl Counter {
        fn new(mut timer: SYST) -> Self {
            timer.set_clock_source(SystClkSource::Core);
            timer.set_reload(RELOAD);
            timer.clear_current();
            timer.enable_counter();
            let ticks = ticks(|| asm::delay(RATE_INSTRUCTIONS / 2));
            Self { instructions_per_tick: f64::from(RATE_INSTRUCTIONS) / f64::from(ticks) }
        }

        fn instructions(&self, ticks: u32) -> f64 {
            f64::from(ticks) * self.instructions_per_tick
        }
    }

    /// The ticks of SysTick that some work takes. Whole numbers, since arithmetic in double precision, which the processor does
    /// in software, might be moved to between the two readings.
    fn ticks(work: impl FnOnce()) -> u32 {
        let begin = SYST::get_current();
        work();
        begin.wrapping_sub(SYST::get_current()) & RELOAD
    }

    /// A sensor that turns: two incommensurable angles cover the sphere; gages and noise in whole counts.
    fn codes(sample: u32) -> [AdcCode; GAGES] {
        let turn = f64::from(sample);
        let height = libm::cos(turn * 1.618_034);
        let radius = libm::sqrt(1.0 - height * height);
        let direction = [radius * libm::cos(turn * 0.7), radius * libm::sin(turn * 0.7), height];
        let mut gages = 0..;
        core::array::from_fn(|_| {
            let gage: u8 = gages.next().unwrap_or(0);
            let angle = f64::from(gage) * 0.9;
            let gains = [libm::cos(angle), libm::sin(angle), 0.5 * libm::cos(2.0 * angle + 0.3)];
            let signal: f64 = gains.iter().zip(&direction).map(|(gain, m)| 300_000.0 * gain * m).sum();
            let noise = (sample.wrapping_mul(2_654_435_761).rotate_left(3 * u32::from(gage)) >> 20)
                .cast_signed()
                - 2048;
            #[expect(clippy::cast_possible_truncation, reason = "far within the converter's range")]
            AdcCode::saturating(i64::from(signal as i32 + noise / 4 + 10_000))
        })
    }

    /// The rows of the turning sensor's three components, and three more: to the others its gages agree but for noise.
    fn matrix() -> [f32; 6 * GAGES] {
        core::array::from_fn(|element| {
            let angle = (element % GAGES) as f32 * 0.9;
            1e-6 * match element / GAGES {
                0 => libm::cosf(angle),
                1 => libm::sinf(angle),
                2 => libm::cosf(2.0 * angle + 0.3),
                3 => libm::sinf(2.0 * angle + 0.3),
                4 => libm::cosf(3.0 * angle),
                _ => libm::sinf(3.0 * angle),
            }
        })
    }

    #[entry]
    fn main() -> ! {
        static mut MOMENTS: Moments<GAGES, HIGHER> = Moments::new([AdcCode::ZERO; GAGES]);
        static mut BINS: Bins<GAGES, HIGHER> = Bins::new();
        static mut PATH_BINS: Bins<GAGES, HIGHER> = Bins::new();
        if let Some(core) = cortex_m::Peripherals::take() {
            let counter = Counter::new(core.SYST);
            solve(&counter, BINS);
            accumulate(&counter, MOMENTS);
            path::measure(&counter, PATH_BINS);
            debug::exit(debug::EXIT_SUCCESS);
        }
        loop {
            asm::bkpt();
        }
    }

    #[inline(never)]
    fn accumulate(counter: &Counter, moments: &mut Moments<GAGES, HIGHER>) {
        moments.restart(codes(0));
        let (mut sum, mut largest) = (0, 0);
        for sample in 0..SAMPLES {
            let codes = codes(sample);
            let ticks = ticks(|| {
                // A trial this short has room for every sample.
                let _ = black_box(moments.push(black_box(&codes)));
            });
            sum += ticks;
            largest = largest.max(ticks);
        }
        hprintln!("accumulate_mean {:.0}", counter.instructions(sum) / f64::from(SAMPLES));
        hprintln!("accumulate_worst {:.0}", counter.instructions(largest));
    }

    /// A trial with all that belongs to it: gate, sums by quietness, solution with covariance, and the gate that knows the solution.
    #[inline(never)]
    fn solve(counter: &Counter, bins: &mut Bins<GAGES, HIGHER>) {
        for sample in 0..SAMPLES {
            let _ = bins.offer(&codes(sample));
        }
        bins.finish();
        let depth = stack::depth();
        let mut solved = None;
        let ticks = ticks(|| solved = black_box(black_box(&*bins).solve(Rank::Spatial).ok()));
        hprintln!("solve {:.0}", counter.instructions(ticks));
        hprintln!("stack_solving {}", stack::used() - depth);
        let expectation = solved.and_then(|solved| Expectation::new(&solved.solution).ok().flatten());
        assert!(expectation.is_some(), "the motion determines the shape");
        gate_and_apply(counter, expectation);
    }

    #[inline(never)]
    fn gate_and_apply(counter: &Counter, expectation: Option<Expectation<GAGES>>) {
        let Ok(calibration) =
            RealTimeCalibration::<GAGES>::new(Dof::SpatialForceTorque, &matrix(), &[10_000.5; GAGES])
        else {
            return;
        };
        let mut gate = Gate::<GAGES>::new();
        gate.expect(expectation);
        let mut health = Health::<GAGES>::new();
        health.watch(ParitySpace::new(&calibration.matrix()), None, DataRate::Hz1000);
        let (mut gated, mut applied, mut measured, mut most) = (0, 0, 0, 0);
        for sample in 0..GATED {
            let codes = codes(sample);
            gated += ticks(|| {
                let is_saturated = AdcCode::any_is_saturated(black_box(&codes));
                black_box(gate.offer(black_box(&codes), is_saturated, &mut |quietness, codes| {
                    black_box((quietness, codes));
                }));
            });
            applied += ticks(|| {
                black_box(black_box(&calibration).apply(black_box(&codes)));
            });
            let sample = Sample { codes, repeating: 0, after_gap: false };
            let ticks = ticks(|| {
                let _ = black_box(black_box(&mut health).measure(Ok(&calibration), 0, black_box(&sample)));
            });
            measured += ticks;
            most = most.max(ticks);
        }
        hprintln!("measure_mean {:.0}", counter.instructions(measured) / f64::from(GATED));
        hprintln!("measure_worst {:.0}", counter.instructions(most));
        hprintln!("gate_and_parity {:.0}", counter.instructions(gated) / f64::from(GATED));
        hprintln!("apply {:.0}", counter.instructions(applied) / f64::from(GATED));
    }

    /// How much of the stack has ever been in use. The run-time paints it before anything runs (`paint-stack`).
    #[expect(unsafe_code, reason = "the memory below the stack belongs to nobody and is only read")]
    mod stack {
        use core::ptr::{addr_of, read_volatile};

        use cortex_m::register::msp;

        /// What `cortex-m-rt` paints with.
        const PAINT: u32 = 0xcccc_cccc;

        unsafe extern "C" {
            static _stack_start: u32;
            static _stack_end: u32;
        }

        /// How deep the stack is now.
        pub(super) fn depth() -> usize {
            addr_of!(_stack_start).addr() - msp::read() as usize
        }

        /// How deep it has ever been.
        pub(super) fn used() -> usize {
            let (mut at, top) = (addr_of!(_stack_end), addr_of!(_stack_start));
            // SAFETY: both symbols are the linker's, aligned to words, and all between them is memory.
            while at < top && unsafe { read_volatile(at) } == PAINT {
                at = at.wrapping_add(1);
            }
            top.addr() - at.addr()
        }
    }
}
