//! The sensor's image: the portable application, wired to the board's interrupts.
//!
//! | priority | task | interrupt | does |
//! |---|---|---|---|
//! | 4 | `link` | USART3 | moves bytes between the line and two queues, nothing else |
//! | 3 | `sample` | EXTI9_5: data-ready | reads the conversion and queues it |
//! | 3 | `tick` | SysTick, every 2 ms | watches over the converter, starts it where it is due; feeds the watchdog |
//! | 2 | `process` | TIM6_DAC, raised by hand | takes readings into the trial, applies the calibration, queues the outcome; looks at the button, and says what the light shows |
//! | 1 | `session` | TIM7, raised by hand | decodes requests, has them answered, puts samples together into frames |
//! | 0 | `idle` | none | reads the memory at the start; then solves trials, stores, and calibrates in the field, in the background |
//!
//! **Why the link comes first.** The line keeps one byte for 11 µs, and the converter's start, which the tick does, takes up to
//! 17 ms. The link's interrupt takes less than a microsecond and shares nothing, so it delays the sample path by no more than
//! that, and no byte is lost whatever the sample path does. (A flash that is being written or erased holds all of them up: 16 µs a word, in
//! which two bytes may come at 921 600 baud, and one is lost now and then. Whoever sends it repeats it.)
//!
//! **What is locked.** `sample` and `tick` share the converter with those below for as long as it takes to exchange orders and report
//! ([`Sensor::exchange`]), and nothing else holds data-ready up. The sensor is shared by `process`, `session` and `idle`: `session` holds
//! it while a request is answered, `idle` while it gives a job's handle back, or the calibration that it has read. Meanwhile
//! readings wait in their queue; one that finds it full is lost, and counted as overrun, and one that is not attended to before
//! the next conversion is due is counted as late. Where they come faster than they are worked off, so that `process` never gets to the
//! end of its queue, it passes over those that come until the next tick, and counts them as overrun, too: whoever is below it must be
//! able to say so, and to hear that the rate is to be lowered. The memory is `idle`'s alone. Queues between two tasks need no lock. A sample of
//! the stream that finds its queue full is dropped and counted.
//!
//! **What is not inlined.** Whatever `session` and `idle` do in turn is in functions of its own, so that only what runs has its frame on the
//! stack: the largest of them would else lie under every interrupt, and under the solution of a trial.
//!
//! TIM6 and TIM7 are used for their interrupts only; the timers themselves stand still.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod board;

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    eprintln!(
        "This is the firmware of the sensor; it runs on an STM32F405, not here. Build it with\n\
         cargo build -p ftcal-firmware --profile firmware --target thumbv7em-none-eabihf --features BOARD\n\
         and bring it to the sensor with `ftcal flash IMAGE`, or run it in the emulator: see firmware/README.md."
    );
    std::process::ExitCode::from(2)
}

#[cfg(target_os = "none")]
#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod app {
    use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

    use ftcal_firmware::acquisition::Acquisition;
    use ftcal_firmware::baud::DEFAULT_BAUD;
    use ftcal_firmware::handover::Reading;
    use ftcal_firmware::sensor::{LinkCounters, Reaction, Sensor};
    use ftcal_firmware::session::{Order, Session, Ticket};
    use ftcal_firmware::storage::checkpoint::TrialAccess;
    use ftcal_firmware::storage::job::{StoreJob, Stored};
    use ftcal_firmware::storage::keeper::Keeper;
    use ftcal_firmware::stream::{Batcher, Moment};
    use ftcal_firmware::trial::{SolveJob, Trial};
    use ftcal_firmware::vitality::{Task, Vitality};
    use ftcal_shared::estimation::bins::Bins;
    use ftcal_shared::estimation::moments::higher_moment_count;
    use ftcal_shared::wire::{AdcState, Rejection, Request, Response};
    use heapless::spsc::{Consumer, Producer, Queue};
    use rtic::Mutex;
    use stm32f4xx_hal::pac::Interrupt;

    use crate::board::link::{Link, LinkQueues, Outbox, is_changing_rate};
    use crate::board::panel::Panel;
    use crate::board::watchdog::Watchdog;
    use crate::board::{Converter, DataReady, Flash, Start, catch_up, set_up, time_base, wiring};

    /// Gages on the converter.
    const GAGES: usize = 8;
    const HIGHER: usize = higher_moment_count(GAGES);

    /// Bytes in either direction that wait for the session or for the line; the longest frame has 521.
    const LINK_QUEUE: usize = 640;
    /// Samples of the stream that wait for the session: at 8000 a second, 2 ms.
    const MOMENT_QUEUE: usize = 16;
    /// Readings that wait, one that is being worked off, and a place that stays free: at 32 000 a second, 14 conversions are 0.4 ms.
    const READING_QUEUE: usize = 16;

    type Store = &'static mut Bins<GAGES, HIGHER>;
    type Job = SolveJob<Store, GAGES, HIGHER>;

    #[shared]
    struct Shared {
        acquisition: Acquisition<Converter, GAGES>,
        sensor: Sensor<Store, GAGES, HIGHER>,
        /// A trial on its way to be solved, and the request that its outcome answers.
        job: Option<(Ticket, Job)>,
        /// Something to be stored, and the request that asks for it.
        store_job: Option<(Ticket, StoreJob)>,
        /// Nothing: whoever holds it keeps `session` from running.
        requests: (),
        /// The outcome on its way to the host.
        outcome: Option<(Ticket, Response)>,
        /// The converter was looked after, and the sensor has not heard of it.
        has_ticked: AtomicBool,
        dropped_samples: AtomicU32,
        vitality: Vitality,
    }

    #[local]
    struct Local {
        link: Link,
        data_ready: DataReady,
        readings_in: Producer<'static, Reading<GAGES>>,
        readings_out: Consumer<'static, Reading<GAGES>>,
        moments_in: Producer<'static, Moment>,
        panel: Panel,
        watchdog: Watchdog,
        start: Start,
        conversation: Conversation,
        keeper: Keeper<Flash>,
    }

    /// The session's ends of the queues.
    pub struct Conversation {
        session: Session,
        received: Consumer<'static, u8>,
        moments: Consumer<'static, Moment>,
        batcher: Batcher,
        outbox: Outbox,
        /// The line's next rate, once all that is in the outbox has left.
        next_baud: Option<u32>,
    }

    impl Conversation {
        /// Sends the next frame of the stream, if one is due.
        #[inline(never)]
        fn go_on_streaming(&mut self) -> bool {
            let line_is_idle = self.outbox.is_idle();
            let due = self.batcher.next(time_base::now(), line_is_idle, || self.moments.dequeue());
            if let Some(frame) = &due {
                self.outbox.put(frame);
            }
            due.is_some()
        }

        /// Answers a request, unless the conversation that it belongs to is over.
        #[inline(never)]
        fn answer(&mut self, ticket: Ticket, response: Response) -> bool {
            let message = self.session.answer(ticket, response);
            if let Some(message) = &message {
                self.outbox.put(message);
            }
            message.is_some()
        }

        /// Whether the line takes the next message: the one before is in its queue, and its rate is not about to change.
        fn is_ready(&mut self) -> bool {
            if !self.outbox.flush() {
                return false;
            }
            if let Some(baud) = self.next_baud.take() {
                self.outbox.change_rate(baud);
                self.session.rate_changed(baud, time_base::now());
            }
            !is_changing_rate()
        }

        /// Has the line change its rate after the next message.
        fn plan_rate(&mut self, baud: u32) -> Response {
            if !self.outbox.has_rate(baud) {
                return Response::Rejected(Rejection::UnsupportedRate);
            }
            self.next_baud = Some(baud);
            Response::Done
        }

        /// Forgets what of the stream has not gone yet.
        fn drop_stream(&mut self) {
            self.batcher.clear();
            while self.moments.dequeue().is_some() {}
        }
    }

    #[init(local = [
        store: Bins<GAGES, HIGHER> = Bins::new(),
        received: Queue<u8, LINK_QUEUE> = Queue::new(),
        to_send: Queue<u8, LINK_QUEUE> = Queue::new(),
        readings: Queue<Reading<GAGES>, READING_QUEUE> = Queue::new(),
        moments: Queue<Moment, MOMENT_QUEUE> = Queue::new(),
    ])]
    fn init(context: init::Context) -> (Shared, Local) {
        let (received_in, received_out) = context.local.received.split();
        let (to_send_in, to_send_out) = context.local.to_send.split();
        let (readings_in, readings_out) = context.local.readings.split();
        let (moments_in, moments_out) = context.local.moments.split();

        let queues = LinkQueues { received: received_in, to_send: to_send_out };
        let board = set_up(context.device, context.core.SYST, queues);
        defmt::info!(
            "ftcal {=str} on {=str}, clock: {}",
            env!("CARGO_PKG_VERSION"),
            wiring::NAME,
            board.clock
        );

        let mut sensor = Sensor::new(context.local.store, board.clock);
        sensor.note_start(&board.start.diagnosis());
        sensor.await_memory();
        let mut acquisition = Acquisition::new(board.converter);
        if cfg!(feature = "soak") {
            acquisition.count_on();
        }
        let shared = Shared {
            acquisition,
            sensor,
            job: None,
            store_job: None,
            requests: (),
            outcome: None,
            has_ticked: AtomicBool::new(false),
            dropped_samples: AtomicU32::new(0),
            vitality: Vitality::new(),
        };
        let conversation = Conversation {
            session: Session::new(),
            received: received_out,
            moments: moments_out,
            batcher: Batcher::new(),
            outbox: Outbox::new(to_send_in, board.link_clock_hertz),
            next_baud: None,
        };
        let local = Local {
            link: board.link,
            data_ready: board.data_ready,
            readings_in,
            readings_out,
            moments_in,
            panel: board.panel,
            watchdog: board.watchdog,
            start: board.start,
            keeper: Keeper::new(board.flash),
            conversation,
        };
        (shared, local)
    }

    /// A byte came, or may go.
    #[task(binds = USART3, priority = 4, local = [link])]
    fn link(context: link::Context) {
        let served = context.local.link.serve();
        if served.received || served.sent_all {
            rtic::pend(Interrupt::TIM7);
        }
    }

    /// The converter announces a conversion.
    #[task(binds = EXTI9_5, priority = 3, local = [data_ready, readings_in], shared = [acquisition])]
    fn sample(mut context: sample::Context) {
        let now = time_base::now();
        let readings = context.local.readings_in;
        context.shared.acquisition.lock(|acquisition| {
            let reading =
                context.local.data_ready.handle(now, |announced| acquisition.on_data_ready(now, announced));
            if let Some(reading) = reading.flatten()
                && readings.enqueue(*reading).is_err()
            {
                acquisition.note_overrun();
            }
        });
        rtic::pend(Interrupt::TIM6_DAC);
    }

    /// Time passes.
    #[task(binds = SysTick, priority = 3, local = [watchdog], shared = [acquisition, &has_ticked, &vitality])]
    fn tick(mut context: tick::Context) {
        time_base::follow();
        context.shared.vitality.report(Task::Tick);
        if context.shared.vitality.all_have_run() {
            context.local.watchdog.feed();
        }
        context
            .shared
            .acquisition
            .lock(|acquisition| acquisition.tick(time_base::now(), &mut time_base::Delay));
        context.shared.has_ticked.store(true, Ordering::Release);
        rtic::pend(Interrupt::TIM6_DAC);
    }

    /// There are readings, or time has passed.
    #[task(
        binds = TIM6_DAC,
        priority = 2,
        local = [readings_out, moments_in, panel, is_shedding: bool = false, logged: AdcState = AdcState::Starting],
        shared = [sensor, acquisition, &has_ticked, &dropped_samples, &vitality]
    )]
    fn process(context: process::Context) {
        let process::SharedResources {
            mut sensor,
            mut acquisition,
            has_ticked,
            dropped_samples,
            vitality,
            ..
        } = context.shared;
        vitality.report(Task::Process);
        let moments = context.local.moments_in;
        let mut queue = |moment: Option<Moment>| {
            let Some(moment) = moment else { return };
            if moments.enqueue(moment).is_err() {
                dropped_samples.fetch_add(1, Ordering::Relaxed);
            }
            rtic::pend(Interrupt::TIM7);
        };
        let is_shedding = context.local.is_shedding;
        sensor.lock(|sensor| {
            let mut in_a_row = 0;
            // It is worked off where it stands.
            while let Some(reading) = context.local.readings_out.peek() {
                if *is_shedding {
                    acquisition.lock(Acquisition::note_overrun);
                } else {
                    queue(sensor.take_in(reading, time_base::now()));
                    in_a_row += 1;
                    *is_shedding = in_a_row > READING_QUEUE;
                }
                let _ = context.local.readings_out.dequeue();
            }
            if has_ticked.swap(false, Ordering::Acquire) {
                *is_shedding = false;
                acquisition.lock(|acquisition| sensor.exchange(acquisition));
                log_converter(context.local.logged, sensor.converter_state());
                queue(sensor.tick(time_base::now()));
                let Panel { button, light } = context.local.panel;
                light.set(sensor.attend_panel(time_base::now(), button.is_pressed()));
                // Samples that wait for others may have waited long enough, and the session is to show that it is alive.
                rtic::pend(Interrupt::TIM7);
            }
        });
        if moments.is_empty() {
            catch_up();
        }
    }

    /// Says in the log what has become of the converter, if that is news.
    fn log_converter(logged: &mut AdcState, state: AdcState) {
        if *logged != state {
            *logged = state;
            match state {
                AdcState::Faulty(fault) => defmt::warn!("converter: {}", fault),
                AdcState::Starting | AdcState::Running => defmt::info!("converter: {}", state),
            }
        }
    }

    /// There is something to read, to answer or to send. One message at a time: the next is made when the one before is in
    /// the line's queue, and where that is full, when the link has emptied it.
    #[task(
        binds = TIM7,
        priority = 1,
        local = [conversation, start],
        shared = [sensor, job, store_job, requests, outcome, &dropped_samples, &vitality]
    )]
    fn session(mut context: session::Context) {
        context.shared.vitality.report(Task::Session);
        watch_host(&mut context);
        while context.local.conversation.is_ready()
            && (tell_outcome(&mut context)
                || hear(&mut context)
                || context.local.conversation.go_on_streaming())
        {}
        if context.local.conversation.moments.is_empty() {
            catch_up();
        }
        rtic::pend(Interrupt::USART3);
    }

    /// Ends what a host that has gone has left running.
    fn watch_host(context: &mut session::Context<'_>) {
        let now = time_base::now();
        let silence = context.local.conversation.session.watch(now);
        if silence.end_stream {
            context.shared.sensor.lock(Sensor::abandon_stream);
        }
        if silence.fall_back {
            context.local.conversation.next_baud = Some(DEFAULT_BAUD);
        }
    }

    /// Sends what has come of a job, if one has ended. This and the next three say whether anything was sent.
    #[inline(never)]
    fn tell_outcome(context: &mut session::Context<'_>) -> bool {
        let outcome = context.shared.outcome.lock(Option::take);
        outcome.is_some_and(|(ticket, response)| context.local.conversation.answer(ticket, response))
    }

    /// Takes in what comes from the host, until there is something to be sent at once, and sends that.
    fn hear(context: &mut session::Context<'_>) -> bool {
        while let Some(byte) = context.local.conversation.received.dequeue() {
            if obey(context, byte) {
                return true;
            }
        }
        false
    }

    /// Takes in one byte from the host, and says whether anything was sent.
    #[inline(never)]
    fn obey(context: &mut session::Context<'_>, byte: u8) -> bool {
        match context.local.conversation.session.on_byte(byte, time_base::now()) {
            None => false,
            Some(Order::Send(message)) => {
                context.local.conversation.outbox.put(&message);
                true
            }
            Some(Order::Serve(ticket, request)) => serve(context, ticket, request),
            Some(Order::ChangeRate(ticket, baud)) => {
                let response = context.local.conversation.plan_rate(baud);
                context.local.conversation.answer(ticket, response)
            }
        }
    }

    /// Has the sensor answer, and says whether an answer was sent: where it takes time, it comes as the outcome of a job.
    #[inline(never)]
    fn serve(context: &mut session::Context<'_>, ticket: Ticket, request: Request) -> bool {
        let now = time_base::now();
        let is_new_stream = matches!(request, Request::Stream(_));
        let counters = LinkCounters {
            dropped_samples: context.shared.dropped_samples.load(Ordering::Relaxed),
            broken_frames: context.local.conversation.session.broken_frames(),
        };
        let reaction = context.shared.sensor.lock(|sensor| sensor.answer(request, now, counters));
        if is_new_stream {
            context.local.conversation.drop_stream();
        }
        let response = match reaction {
            Reaction::Respond(response) => response,
            Reaction::Diagnose => Response::Diagnosis(context.local.start.diagnosis()),
            Reaction::Solve(job) => {
                context.shared.job.lock(|waiting| *waiting = Some((ticket, job)));
                return false;
            }
            Reaction::Store(job) => {
                context.shared.store_job.lock(|waiting| *waiting = Some((ticket, job)));
                return false;
            }
        };
        context.local.conversation.answer(ticket, response)
    }

    /// Solves trials, stores, calibrates in the field, or sleeps. A job that comes just before the sleep waits for the next interrupt: 2 ms at most.
    #[idle(local = [keeper], shared = [sensor, job, store_job, requests, outcome, &vitality])]
    fn idle(context: idle::Context) -> ! {
        let keeper = context.local.keeper;
        let idle::SharedResources { sensor, mut job, mut store_job, requests, mut outcome, vitality, .. } =
            context.shared;
        let mut access = Access { sensor, requests: Some(requests) };
        restore(keeper, &mut access);
        loop {
            vitality.report(Task::Background);
            let is_done = solve(&mut job, &mut access.sensor, &mut outcome)
                || store(&mut store_job, keeper, &mut access.sensor, &mut outcome);
            if is_done {
                rtic::pend(Interrupt::TIM7);
            } else if !calibrate_in_the_field(keeper, &mut access.sensor)
                && !keep_house(keeper, &mut access.sensor)
            {
                keeper.attend(time_base::now(), &mut access);
                cortex_m::asm::wfi();
            }
        }
    }

    /// Takes up what was kept before the reset.
    #[inline(never)]
    fn restore<SharedSensor, Requests>(
        keeper: &mut Keeper<Flash>,
        access: &mut Access<SharedSensor, Requests>,
    ) where
        SharedSensor: Mutex<T = Sensor<Store, GAGES, HIGHER>>,
        Requests: Mutex,
    {
        let found = keeper.start(access);
        match &found.kept {
            Ok(kept) => defmt::info!("calibration: {}", kept.calibrations.current),
            Err(error) => defmt::error!("the memory cannot be read: {}", error),
        }
        access.sensor.lock(|sensor| sensor.restore(found));
    }

    /// Solves the trial that waits for it, if one does.
    #[inline(never)]
    fn solve(
        job: &mut impl Mutex<T = Option<(Ticket, Job)>>,
        sensor: &mut impl Mutex<T = Sensor<Store, GAGES, HIGHER>>,
        outcome: &mut impl Mutex<T = Option<(Ticket, Response)>>,
    ) -> bool {
        let Some((ticket, mut job)) = job.lock(Option::take) else { return false };
        let response = job.response();
        sensor.lock(|sensor| sensor.finish_solving(job));
        outcome.lock(|outcome| *outcome = Some((ticket, response)));
        true
    }

    /// Stores what waits for it, if anything does.
    #[inline(never)]
    fn store(
        store_job: &mut impl Mutex<T = Option<(Ticket, StoreJob)>>,
        keeper: &mut Keeper<Flash>,
        sensor: &mut impl Mutex<T = Sensor<Store, GAGES, HIGHER>>,
        outcome: &mut impl Mutex<T = Option<(Ticket, Response)>>,
    ) -> bool {
        let Some((ticket, job)) = store_job.lock(Option::take) else { return false };
        let stored = keeper.run(&job);
        if let Stored::Failed(error) = &stored {
            defmt::error!("not stored: {}", error);
        }
        let response = sensor.lock(|sensor| sensor.finish_storing(stored));
        outcome.lock(|outcome| *outcome = Some((ticket, response)));
        true
    }

    /// Stores what nobody has to ask for, if there is something.
    #[inline(never)]
    fn keep_house(
        keeper: &mut Keeper<Flash>,
        sensor: &mut impl Mutex<T = Sensor<Store, GAGES, HIGHER>>,
    ) -> bool {
        let Some(job) = sensor.lock(|sensor| sensor.housekeeping(time_base::now())) else { return false };
        let stored = keeper.run(&job);
        // It was nobody's request.
        let _ = sensor.lock(|sensor| sensor.finish_storing(stored));
        true
    }

    /// Goes one step on with a calibration in the field, if there is one to be made.
    #[inline(never)]
    fn calibrate_in_the_field(
        keeper: &mut Keeper<Flash>,
        sensor: &mut impl Mutex<T = Sensor<Store, GAGES, HIGHER>>,
    ) -> bool {
        let task = sensor.lock(|sensor| sensor.field_task(time_base::now()));
        let Some(task) = task else { return false };
        let done = task.run(keeper);
        sensor.lock(|sensor| sensor.finish_field(done, time_base::now()));
        true
    }

    /// The way of `idle` to the trial: it holds up the sample path for a glance, and requests for as long as it has the sums.
    struct Access<SharedSensor, Requests> {
        sensor: SharedSensor,
        /// Absent while they are held up.
        requests: Option<Requests>,
    }

    impl<SharedSensor, Requests> TrialAccess<Store, GAGES, HIGHER> for Access<SharedSensor, Requests>
    where
        SharedSensor: Mutex<T = Sensor<Store, GAGES, HIGHER>>,
        Requests: Mutex,
    {
        fn with<Answer>(&mut self, act: impl FnOnce(&mut Trial<Store, GAGES, HIGHER>) -> Answer) -> Answer {
            self.sensor.lock(|sensor| act(sensor.trial()))
        }

        fn undisturbed<Answer>(&mut self, act: impl FnOnce(&mut Self) -> Answer) -> Answer {
            let Some(mut requests) = self.requests.take() else { return act(self) };
            let answer = requests.lock(|_| act(self));
            self.requests = Some(requests);
            answer
        }
    }
}
