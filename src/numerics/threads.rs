//! Work on plain threads.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// `work(0)` to `work(n − 1)`, in that order, each on the next of as many threads as rayon has. For work that may wait for others:
/// rayon's own threads must not, or nobody is left to do what they wait for.
///
/// # Panics
/// When `work` does.
pub fn on_threads<T: Send>(n: usize, work: impl Fn(usize) -> T + Sync) -> Vec<T> {
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
    std::thread::scope(|scope| (0..rayon::current_num_threads().min(n)).for_each(|_| drop(scope.spawn(run))));
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
}
