//! Work on plain threads.

use std::cell::Cell;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

thread_local! {
    /// Threads that work on this one may use; all there are where nothing else is said.
    static AVAILABLE: Cell<Option<usize>> = const { Cell::new(None) };
}

/// Threads that work on this one may use.
pub fn available() -> usize {
    AVAILABLE.get().unwrap_or_else(rayon::current_num_threads)
}

/// `work` on one of `count` threads that share what is [`available`] to the thread that counts them.
pub fn sharing<T>(available: usize, count: usize, work: impl FnOnce() -> T) -> T {
    let before = AVAILABLE.replace(Some((available / count.max(1)).max(1)));
    let found = work();
    AVAILABLE.set(before);
    found
}

/// `work(0)` to `work(n − 1)`, in that order, each on the next of as many threads as are [`available`]; work within work shares them. For
/// work that may wait for others: rayon's own threads must not, or nobody is left to do what they wait for.
///
/// # Panics
/// When `work` does.
pub fn on_threads<T: Send>(n: usize, work: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let available = available();
    let count = available.min(n);
    if count < 2 {
        return (0..n).map(work).collect();
    }
    let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::with_capacity(n)));
    let run = || {
        loop {
            let i = next.fetch_add(1, Ordering::Relaxed);
            if i >= n {
                return;
            }
            let found = work(i);
            done.lock().unwrap_or_else(PoisonError::into_inner).push((i, found));
        }
    };
    std::thread::scope(|scope| (0..count).for_each(|_| drop(scope.spawn(|| sharing(available, count, run)))));
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by_key(|(i, _)| *i);
    done.into_iter().map(|(_, found)| found).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_come_in_order_whoever_is_first() {
        let slow_first = |i: usize| {
            std::thread::sleep(std::time::Duration::from_millis(20 - 4 * i as u64));
            i * i
        };
        assert_eq!(on_threads(5, slow_first), [0, 1, 4, 9, 16]);
        assert!(on_threads(0, slow_first).is_empty());
    }

    #[test]
    fn work_within_work_shares_the_threads() {
        let seen = sharing(12, 1, || on_threads(4, |_| (available(), on_threads(3, |_| available()))));
        assert_eq!(seen, vec![(3, vec![1, 1, 1]); 4]);
    }
}
