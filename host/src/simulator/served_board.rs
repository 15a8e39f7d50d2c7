//! For tests: a simulated board that a thread serves on a pseudo-terminal until it is dropped.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};

use super::board::SimulatedBoard;
use super::bus::SharedBench;
use super::pseudo_terminal::PseudoTerminal;
use super::scenario::{Scenario, ScenarioKind};

/// A served board.
pub(crate) struct ServedBoard {
    /// The port.
    pub(crate) path: String,
    /// The bench under the board.
    pub(crate) bench: SharedBench,
    stop: Arc<AtomicBool>,
    server: Option<JoinHandle<()>>,
}

impl ServedBoard {
    /// A board with this scenario's sensor, the first trial's load hanging on it.
    pub(crate) fn new(kind: ScenarioKind) -> Self {
        let scenario = Scenario::new(kind, 3).expect("sizes fit");
        let board = SimulatedBoard::for_scenario(&scenario, 3).expect("sizes fit");
        let bench = board.bench();
        bench.with(|bench| bench.hang(scenario.trials[0].load));
        let mut board = board.into_board();
        let mut terminal = PseudoTerminal::open().expect("a pseudo-terminal");
        let path = terminal.path().display().to_string();
        let stop = Arc::new(AtomicBool::new(false));
        let told = Arc::clone(&stop);
        let serve = move || terminal.serve(board.as_mut(), &told).expect("a second handle");
        Self { path, bench, stop, server: Some(thread::spawn(serve)) }
    }
}

impl Drop for ServedBoard {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(server) = self.server.take() {
            server.join().expect("the server does not panic");
        }
    }
}
