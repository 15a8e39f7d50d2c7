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
mod target {
    use core::hint::black_box;
    use core::panic::PanicInfo;

    use cortex_m::asm;
    use cortex_m::peripheral::SYST;
    use cortex_m::peripheral::syst::SystClkSource;
    use cortex_m_rt::entry;
    use cortex_m_semihosting::{debug, hprintln};
    use defmt_rtt as _;
    use ftcal_shared::estimation::application::RealTimeCalibration;
    use ftcal_shared::estimation::moments::{BLOCK, Moments, higher_moment_count};
    use ftcal_shared::estimation::shape::solve_trial;
    use ftcal_shared::units::{AdcCode, Dof};
    // The interrupt table comes with the device.
    use stm32f4xx_hal as _;

    const GAGES: usize = 8;
    const HIGHER: usize = higher_moment_count(GAGES);

    /// Samples of the trial: two whole blocks of the sums, so that bringing them into the long sums is counted, too.
    const SAMPLES: u32 = 2 * BLOCK as u32;

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
            let mut counter = Self { instructions_per_tick: 1.0 };
            let ticks = counter.instructions(|| asm::delay(RATE_INSTRUCTIONS / 2));
            counter.instructions_per_tick = f64::from(RATE_INSTRUCTIONS) / ticks;
            counter
        }

        fn instructions(&self, work: impl FnOnce()) -> f64 {
            let begin = SYST::get_current();
            work();
            let ticks = begin.wrapping_sub(SYST::get_current()) & RELOAD;
            f64::from(ticks) * self.instructions_per_tick
        }
    }

    /// A sensor that turns: two incommensurable angles cover the sphere; gages and noise in whole counts.
    fn codes(sample: u32) -> [AdcCode; GAGES] {
        let turn = f64::from(sample);
        let height = libm::cos(turn * 1.618_034);
        let radius = libm::sqrt(1.0 - height * height);
        let direction = [radius * libm::cos(turn * 0.7), radius * libm::sin(turn * 0.7), height];
        core::array::from_fn(|gage| {
            let angle = gage as f64 * 0.9;
            let gains = [libm::cos(angle), libm::sin(angle), 0.5 * libm::cos(2.0 * angle + 0.3)];
            let signal: f64 = gains.iter().zip(&direction).map(|(gain, m)| 300_000.0 * gain * m).sum();
            let noise = (sample.wrapping_mul(2_654_435_761).rotate_left(3 * gage as u32) >> 20) as i32 - 2048;
            #[expect(clippy::cast_possible_truncation, reason = "far within the converter's range")]
            AdcCode::saturating(i64::from(signal as i32 + noise / 4 + 10_000))
        })
    }

    #[entry]
    fn main() -> ! {
        static mut STORE: Moments<GAGES, HIGHER> = Moments::new([AdcCode::ZERO; GAGES]);
        if let Some(core) = cortex_m::Peripherals::take() {
            measure(&Counter::new(core.SYST), STORE);
            debug::exit(debug::EXIT_SUCCESS);
        }
        loop {
            asm::bkpt();
        }
    }

    fn measure(counter: &Counter, moments: &mut Moments<GAGES, HIGHER>) {
        moments.restart(codes(0));
        let (mut sum, mut largest) = (0.0, 0.0_f64);
        for sample in 0..SAMPLES {
            let codes = codes(sample);
            let instructions = counter.instructions(|| {
                // A trial this short has room for every sample.
                let _ = black_box(moments.push(black_box(&codes)));
            });
            sum += instructions;
            largest = largest.max(instructions);
        }
        hprintln!("accumulate_mean {:.0}", sum / f64::from(SAMPLES));
        hprintln!("accumulate_worst {:.0}", largest);

        moments.settle();
        let mut solved = false;
        let instructions = counter.instructions(|| {
            solved = black_box(solve_trial::<GAGES, HIGHER, 3>(black_box(moments))).is_ok();
        });
        assert!(solved, "the motion determines the shape");
        hprintln!("solve {:.0}", instructions);

        let matrix: [f32; 6 * GAGES] = core::array::from_fn(|element| 1e-4 * element as f32);
        if let Ok(calibration) =
            RealTimeCalibration::<GAGES>::new(Dof::SpatialForceTorque, &matrix, &[1000.5; GAGES])
        {
            let sample = codes(1);
            let repetitions = 100_u32;
            let instructions = counter.instructions(|| {
                for _ in 0..repetitions {
                    black_box(black_box(&calibration).apply(black_box(&sample)));
                }
            });
            hprintln!("apply {:.0}", instructions / f64::from(repetitions));
        }
    }
}
