//! Runs long calls from Python in a process that belongs to the caller.
//!
//! The work runs on a new thread with a new pool, which both end with the call. It therefore changes nothing in the process, and no pool is
//! left for a fork. Meanwhile the calling thread releases the interpreter's lock, checks for signals ten times a second, and reports
//! progress.

use crate::errors::{Fault, error};
use pyo3::prelude::*;
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use stemgen::progress::Progress;

/// Time between two checks for signals and reports of progress.
const LOOK: Duration = Duration::from_millis(100);
/// Longest wait for interrupted work. After this time the call returns, and the work ends at its next check.
const GRACE: Duration = Duration::from_millis(700);

/// Threads and progress of a call.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Running {
    /// Number of threads; all processors when `None`.
    threads: Option<usize>,
    /// Is called with (stage, unit, done, total). `None` for no reports.
    progress: Option<Py<PyAny>>,
}

/// An event that is reported to the caller.
enum Event {
    Start { stage: String, unit: String, total: u64 },
    Finish,
    Warning(String),
}

/// Passes reports of the library to the caller, and interrupts to the library.
pub struct LongCall {
    stop: AtomicBool,
    done: AtomicU64,
    events: Sender<Event>,
}

impl LongCall {
    fn tell(&self, event: Event) {
        // After an interrupt there may be no receiver, so a failed send is no error.
        let _ = self.events.send(event);
    }
}

impl Progress for LongCall {
    fn start(&self, stage: &str, unit: &str, total: u64) {
        self.done.store(0, Relaxed);
        self.tell(Event::Start { stage: stage.to_owned(), unit: unit.to_owned(), total });
    }
    fn advance(&self, n: u64) {
        self.done.fetch_add(n, Relaxed);
    }
    fn finish(&self) {
        self.tell(Event::Finish);
    }
    fn warn(&self, message: &str) {
        self.tell(Event::Warning(message.to_owned()));
    }
    fn interrupted(&self) -> bool {
        self.stop.load(Relaxed)
    }
}

/// The reported stage.
struct StageText {
    stage: String,
    unit: String,
    total: u64,
}

/// The calling thread's side of a call: receives events, and reports them to Python.
struct Listener {
    call: Arc<LongCall>,
    events: Receiver<Event>,
    running: Running,
    stage: Option<StageText>,
}

impl Listener {
    /// Reports all events so far to Python.
    fn listen(&mut self, py: Python<'_>) -> PyResult<()> {
        while let Ok(event) = self.events.try_recv() {
            match event {
                Event::Start { stage, unit, total } => {
                    self.stage = Some(StageText { stage, unit, total });
                    self.report(py, Some(0))?;
                }
                Event::Finish => {
                    let total = self.stage.as_ref().map(|stage| stage.total);
                    self.report(py, total)?;
                    self.stage = None;
                }
                Event::Warning(message) => warn(py, &message)?,
            }
        }
        self.report(py, None)
    }

    fn report(&self, py: Python<'_>, done: Option<u64>) -> PyResult<()> {
        let (Some(stage), Some(callback)) = (&self.stage, &self.running.progress) else {
            return Ok(());
        };
        let done = done.unwrap_or_else(|| self.call.done.load(Relaxed)).min(stage.total);
        callback.call1(py, (&stage.stage, &stage.unit, done, stage.total)).map(drop)
    }
}

fn warn(py: Python<'_>, message: &str) -> PyResult<()> {
    let logger = py.import("logging")?.call_method1("getLogger", ("stemworlds",))?;
    logger.call_method1("warning", ("%s", message)).map(drop)
}

type Outcome<T> = Result<Result<T, Fault>, Box<dyn Any + Send>>;

/// Runs `work` as described for [the module](self). `work` owns its data, so that an interrupted call can return at once.
pub fn run<T, W>(py: Python<'_>, running: Running, work: W) -> PyResult<T>
where
    T: Send + 'static,
    W: FnOnce(&LongCall) -> Result<T, Fault> + Send + 'static,
{
    let (events, heard) = channel();
    let call = Arc::new(LongCall { stop: AtomicBool::new(false), done: AtomicU64::new(0), events });
    // The mutex makes the receiver shareable, which releasing the interpreter's lock requires.
    let ended = Mutex::new(start(call.clone(), running.threads, work)?);
    let mut listener = Listener { call, events: heard, running, stage: None };
    let mut asked: Option<(PyErr, Instant)> = None;
    loop {
        let received =
            py.detach(|| ended.lock().unwrap_or_else(PoisonError::into_inner).recv_timeout(LOOK));
        if asked.is_none() {
            let heard = py.check_signals().and_then(|()| listener.listen(py));
            if let Err(wish) = heard {
                listener.call.stop.store(true, Relaxed);
                asked = Some((wish, Instant::now()));
            }
        }
        match (received, asked.take()) {
            (Err(RecvTimeoutError::Timeout), Some((wish, since))) if since.elapsed() > GRACE => {
                return Err(wish);
            }
            (Err(RecvTimeoutError::Timeout), still) => asked = still,
            (_, Some((wish, _))) => return Err(wish),
            (Ok(outcome), None) => return finished(py, outcome),
            (Err(RecvTimeoutError::Disconnected), None) => {
                return Err(error(py, Fault::Internal("the computation ended".into())));
            }
        }
    }
}

/// Starts the work. Its result is sent when it ends.
fn start<T, W>(
    call: Arc<LongCall>,
    threads: Option<usize>,
    work: W,
) -> PyResult<Receiver<Outcome<T>>>
where
    T: Send + 'static,
    W: FnOnce(&LongCall) -> Result<T, Fault> + Send + 'static,
{
    let (send, ended) = channel();
    let body = move || {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads.unwrap_or(0))
            .thread_name(|n| format!("stemworlds-{n}"));
        let outcome = match pool.build() {
            Ok(pool) => catch_unwind(AssertUnwindSafe(|| pool.install(|| work(&call)))),
            Err(e) => Ok(Err(Fault::Internal(format!("cannot start threads: {e}")))),
        };
        let _ = send.send(outcome);
    };
    std::thread::Builder::new().name("stemworlds".into()).spawn(body)?;
    Ok(ended)
}

fn finished<T>(py: Python<'_>, outcome: Outcome<T>) -> PyResult<T> {
    match outcome {
        Ok(result) => result.map_err(|fault| error(py, fault)),
        Err(panic) => {
            let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
            let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
            Err(error(py, Fault::Internal(text.unwrap_or_default())))
        }
    }
}
