//! Long calls: the interpreter lock is released, Ctrl-C is heard, threads are chosen.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use faer::Par;
use pyo3::prelude::*;
use rayon::ThreadPool;

/// How often signals are looked for.
const POLL: Duration = Duration::from_millis(50);

/// How long cancelled work is waited for; a factorisation under way cannot be cut short.
const PATIENCE: Duration = Duration::from_millis(500);

/// Runs `work` on a thread of its own, without the lock, and returns what it returns.
///
/// # Errors
///
/// What `tick` or a signal raises, and what the system says where it gives no thread.
///
/// Meanwhile `tick` is called every 50 ms, and once at the end, and signals are looked for. If either raises, `cancel`
/// is set and the exception goes on: at once where the work looks at `cancel` often, and after half a second in any
/// case. Work that was abandoned ends by itself at its next check; this is why it owns all it uses.
pub fn run_watched<T: Send + 'static>(
    py: Python<'_>,
    cancel: &AtomicBool,
    mut tick: impl FnMut(Python<'_>) -> PyResult<()>,
    work: impl FnOnce() -> T + Send + 'static,
) -> PyResult<T> {
    let (finished, mut waiting) = mpsc::channel::<()>();
    let worker = std::thread::Builder::new().spawn(move || {
        // Dropped when the work is done, and when it panics.
        let _finished = finished;
        work()
    })?;
    loop {
        let (receiver, reply) = wait(py, waiting, POLL);
        waiting = receiver;
        if let Err(error) = py.check_signals().and_then(|()| tick(py)) {
            cancel.store(true, Ordering::Relaxed);
            let _ended_or_left = wait(py, waiting, PATIENCE);
            return Err(error);
        }
        if reply == Err(RecvTimeoutError::Disconnected) {
            return match py.detach(|| worker.join()) {
                Ok(value) => Ok(value),
                Err(panic) => std::panic::resume_unwind(panic),
            };
        }
    }
}

type Waiting = mpsc::Receiver<()>;

/// Waits without the lock until the sender is dropped, or for some time.
fn wait(
    py: Python<'_>,
    waiting: Waiting,
    time: Duration,
) -> (Waiting, Result<(), RecvTimeoutError>) {
    py.detach(move || {
        let reply = waiting.recv_timeout(time);
        (waiting, reply)
    })
}

/// Runs something short without the lock on `threads` threads (0: all cores).
pub fn run_released<T: Send>(
    py: Python<'_>,
    threads: usize,
    work: impl FnOnce(Par) -> T + Send,
) -> T {
    py.detach(|| match threads {
        1 => work(Par::Seq),
        0 => work(Par::rayon(0)),
        n => match pool_of(n) {
            Some(pool) => pool.install(|| work(NonZeroUsize::new(n).map_or(Par::Seq, Par::Rayon))),
            None => work(Par::Seq),
        },
    })
}

/// A pool of `n` threads, made once; `None` where the system gives no threads.
fn pool_of(n: usize) -> Option<Arc<ThreadPool>> {
    static POOLS: OnceLock<Mutex<BTreeMap<usize, Arc<ThreadPool>>>> = OnceLock::new();
    let mut pools =
        POOLS.get_or_init(Mutex::default).lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(pool) = pools.get(&n) {
        return Some(pool.clone());
    }
    let pool = Arc::new(rayon::ThreadPoolBuilder::new().num_threads(n).build().ok()?);
    pools.insert(n, pool.clone());
    Some(pool)
}
