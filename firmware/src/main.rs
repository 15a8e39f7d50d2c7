//! The sensor's image: the portable application, wired to the board's interrupts.
//!
//! | priority | task | interrupt | does |
//! |---|---|---|---|
//! | 4 | `link` | USART2 | moves bytes between the line and two queues, nothing else |
//! | 3 | `sample` | EXTI9_5: data-ready | the sample path: read, take into the trial, apply, queue a stream frame |
//! | 3 | `tick` | SysTick, every 10 ms | watches over the converter, starts it where it is due |
//! | 2 | `session` | TIM7, raised by hand | decodes requests, has them answered, encodes what goes to the host |
//! | 0 | `idle` | none | reads the memory at the start; then solves trials and stores, in the background |
//!
//! **Why the link comes first.** The line keeps one byte for 11 µs, and the converter's start, which the tick does, takes up to
//! 17 ms. The link's interrupt takes less than a microsecond and shares nothing, so it delays the sample path by no more than
//! that, and no byte is lost whatever the sample path does.
//!
//! **What is locked.** The sensor is shared by `sample`, `tick`, `session` and `idle`. `session` holds it while a request is
//! answered, which is at most the checksum of an uploaded calibration; `idle` while it gives a job's handle back, or the
//! calibration that it has read. The memory is `idle`'s alone. Queues
//! between two tasks need no lock. A stream frame that finds its queue full is dropped and counted.
//!
//! TIM7 is used for its interrupt only; the timer itself stands still.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod board;

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    eprintln!(
        "This is the firmware of the sensor; it runs on an STM32F405, not here. Build it with\n\
         cargo build -p ftcal-firmware --profile firmware --target thumbv7em-none-eabihf\n\
         and bring it to the sensor with `ftcal flash IMAGE`, or run it in the emulator: see the README."
    );
    std::process::ExitCode::from(2)
}

#[cfg(target_os = "none")]
#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod app {
    use core::sync::atomic::{AtomicU32, Ordering};

    use ftcal_firmware::sensor::{LinkCounters, Reaction, Sensor, StreamFrame};
    use ftcal_firmware::session::{Session, hello};
    use ftcal_firmware::storage::checkpoint::TrialAccess;
    use ftcal_firmware::storage::job::StoreJob;
    use ftcal_firmware::storage::keeper::Keeper;
    use ftcal_firmware::trial::{SolveJob, Trial};
    use ftcal_shared::estimation::bins::Bins;
    use ftcal_shared::estimation::moments::higher_moment_count;
    use ftcal_shared::wire::{Request, RequestId, Response, ToDevice, ToHost};
    use heapless::spsc::{Consumer, Producer, Queue};
    use rtic::Mutex;
    use stm32f4xx_hal::pac::Interrupt;

    use crate::board::link::{Link, LinkQueues, Outbox};
    use crate::board::{Converter, DataReady, Flash, set_up, time_base};

    /// Gages on the converter.
    const GAGES: usize = 8;
    const HIGHER: usize = higher_moment_count(GAGES);

    /// Bytes in either direction that wait for the session or for the line; the longest frame has 521.
    const LINK_QUEUE: usize = 768;
    /// Stream frames that wait for the line: at 1000 samples a second, 30 ms.
    const FRAME_QUEUE: usize = 32;

    type Store = &'static mut Bins<GAGES, HIGHER>;
    type Job = SolveJob<Store, GAGES, HIGHER>;

    #[shared]
    struct Shared {
        sensor: Sensor<Converter, Store, GAGES, HIGHER>,
        /// A trial on its way to be solved, and the request that its outcome answers.
        job: Option<(RequestId, Job)>,
        /// Something to be stored, and the request that asks for it.
        store_job: Option<(RequestId, StoreJob)>,
        /// Nothing: whoever holds it keeps `session` from running.
        requests: (),
        /// The outcome on its way to the host.
        outcome: Option<(RequestId, Response)>,
        /// Where the sample path leaves what it streams: its two tasks have the same priority.
        #[lock_free]
        frames: Producer<'static, StreamFrame>,
        dropped_frames: AtomicU32,
    }

    #[local]
    struct Local {
        link: Link,
        data_ready: DataReady,
        conversation: Conversation,
        keeper: Keeper<Flash>,
    }

    /// The session's ends of the queues.
    pub struct Conversation {
        session: Session,
        received: Consumer<'static, u8>,
        frames: Consumer<'static, StreamFrame>,
        outbox: Outbox,
    }

    #[init(local = [
        store: Bins<GAGES, HIGHER> = Bins::new(),
        received: Queue<u8, LINK_QUEUE> = Queue::new(),
        to_send: Queue<u8, LINK_QUEUE> = Queue::new(),
        frames: Queue<StreamFrame, FRAME_QUEUE> = Queue::new(),
    ])]
    fn init(context: init::Context) -> (Shared, Local) {
        let (received_in, received_out) = context.local.received.split();
        let (to_send_in, to_send_out) = context.local.to_send.split();
        let (frames_in, frames_out) = context.local.frames.split();

        let queues = LinkQueues { received: received_in, to_send: to_send_out };
        let board = set_up(context.device, context.core.SYST, queues);
        defmt::info!("ftcal {=str}, clock: {}", env!("CARGO_PKG_VERSION"), board.clock);

        let shared = Shared {
            sensor: Sensor::new(board.converter, context.local.store, board.clock),
            job: None,
            store_job: None,
            requests: (),
            outcome: None,
            frames: frames_in,
            dropped_frames: AtomicU32::new(0),
        };
        let conversation = Conversation {
            session: Session::new(),
            received: received_out,
            frames: frames_out,
            outbox: Outbox::new(to_send_in),
        };
        let keeper = Keeper::new(board.flash);
        (shared, Local { link: board.link, data_ready: board.data_ready, conversation, keeper })
    }

    /// A byte came, or may go.
    #[task(binds = USART2, priority = 4, local = [link])]
    fn link(context: link::Context) {
        let served = context.local.link.serve();
        if served.received || served.sent_all {
            rtic::pend(Interrupt::TIM7);
        }
    }

    /// The converter announces a conversion.
    #[task(binds = EXTI9_5, priority = 3, local = [data_ready], shared = [sensor, frames, &dropped_frames])]
    fn sample(mut context: sample::Context) {
        let now = time_base::now();
        let frame = context.local.data_ready.handle(now, |announced| {
            context.shared.sensor.lock(|sensor| sensor.on_data_ready(now, announced))
        });
        queue_frame(frame.flatten(), context.shared.frames, context.shared.dropped_frames);
    }

    /// Time passes.
    #[task(binds = SysTick, priority = 3, shared = [sensor, frames, &dropped_frames])]
    fn tick(mut context: tick::Context) {
        time_base::follow();
        let frame = context.shared.sensor.lock(|sensor| sensor.tick(time_base::now(), &mut time_base::Delay));
        queue_frame(frame, context.shared.frames, context.shared.dropped_frames);
    }

    fn queue_frame(frame: Option<StreamFrame>, frames: &mut Producer<'_, StreamFrame>, dropped: &AtomicU32) {
        let Some(frame) = frame else { return };
        if frames.enqueue(frame).is_err() {
            dropped.fetch_add(1, Ordering::Relaxed);
        }
        rtic::pend(Interrupt::TIM7);
    }

    /// There is something to read, to answer or to send. One message at a time: the next is made when the one before is in
    /// the line's queue, and where that is full, when the link has emptied it.
    #[task(binds = TIM7, priority = 2, local = [conversation], shared = [sensor, job, store_job, requests, outcome, &dropped_frames])]
    fn session(mut context: session::Context) {
        while context.local.conversation.outbox.flush() {
            let Some(message) = next_message(&mut context) else { break };
            context.local.conversation.outbox.put(&message);
        }
        rtic::pend(Interrupt::USART2);
    }

    /// What goes to the host next: answers before samples.
    fn next_message(context: &mut session::Context<'_>) -> Option<ToHost> {
        if let Some((id, response)) = context.shared.outcome.lock(Option::take) {
            return Some(ToHost::Response(id, response));
        }
        while let Some(byte) = context.local.conversation.received.dequeue() {
            let answer = match context.local.conversation.session.on_byte(byte) {
                None => None,
                Some(ToDevice::Hello) => Some(ToHost::Hello(hello())),
                Some(ToDevice::Request(id, request)) => {
                    answer(context, id, request).map(|response| ToHost::Response(id, response))
                }
            };
            if answer.is_some() {
                return answer;
            }
        }
        context.local.conversation.frames.dequeue().map(ToHost::from)
    }

    /// Has the sensor answer; `None` where the answer takes time and comes as the outcome of a job.
    fn answer(context: &mut session::Context<'_>, id: RequestId, request: Request) -> Option<Response> {
        let now = time_base::now();
        let counters = LinkCounters {
            dropped_frames: context.shared.dropped_frames.load(Ordering::Relaxed),
            broken_frames: context.local.conversation.session.broken_frames(),
        };
        match context.shared.sensor.lock(|sensor| sensor.answer(request, now, counters)) {
            Reaction::Respond(response) => Some(response),
            Reaction::Solve(job) => {
                context.shared.job.lock(|waiting| *waiting = Some((id, job)));
                None
            }
            Reaction::Store(job) => {
                context.shared.store_job.lock(|waiting| *waiting = Some((id, job)));
                None
            }
        }
    }

    /// Solves trials and stores, or sleeps. A job that comes just before the sleep waits for the next interrupt: 10 ms at most.
    #[idle(local = [keeper], shared = [sensor, job, store_job, requests, outcome])]
    fn idle(context: idle::Context) -> ! {
        let keeper = context.local.keeper;
        let idle::SharedResources { sensor, mut job, mut store_job, requests, mut outcome, .. } =
            context.shared;
        let mut access = Access { sensor, requests: Some(requests) };
        let found = keeper.start(&mut access);
        access.sensor.lock(|sensor| sensor.restore(found));
        loop {
            let (id, response) = if let Some((id, mut job)) = job.lock(Option::take) {
                let response = job.response();
                access.sensor.lock(|sensor| sensor.finish_solving(job));
                (id, response)
            } else if let Some((id, job)) = store_job.lock(Option::take) {
                let stored = keeper.run(&job);
                (id, access.sensor.lock(|sensor| sensor.finish_storing(stored)))
            } else {
                keeper.attend(time_base::now(), &mut access);
                cortex_m::asm::wfi();
                continue;
            };
            outcome.lock(|outcome| *outcome = Some((id, response)));
            rtic::pend(Interrupt::TIM7);
        }
    }

    /// The way of `idle` to the trial: it holds up the sample path for a glance, and requests for as long as it has the sums.
    struct Access<SharedSensor, Requests> {
        sensor: SharedSensor,
        /// Absent while they are held up.
        requests: Option<Requests>,
    }

    impl<SharedSensor, Requests> TrialAccess<Store, GAGES, HIGHER> for Access<SharedSensor, Requests>
    where
        SharedSensor: Mutex<T = Sensor<Converter, Store, GAGES, HIGHER>>,
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
