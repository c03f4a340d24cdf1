//! Items of an ensemble on the threads of this machine.
//!
//! Every worker takes the next item that is neither stored nor being computed elsewhere, so two processes that share a cache
//! share the work; only at the end does one wait for what the other holds. Workers are plain threads and hold no permit
//! while they wait for a lock, so nothing waits in a circle.

use super::slurm::{Shard, Submission, mark};
use crate::error::{Context, Error, Result};
use crate::numerics::threads;
use crate::pipeline::parameters::leaves;
use crate::pipeline::{Address, Item, ItemRecord, Lock, Parts, State, Store};
use crate::progress::Progress;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Instant;

/// How many items may be computed at once, over all stages of a run.
pub(in crate::pipeline) struct Permits {
    free: Mutex<usize>,
    returned: Condvar,
    total: usize,
}

struct Permit<'a>(&'a Permits);

impl Permits {
    pub(in crate::pipeline) fn new(total: usize) -> Self {
        let total = total.max(1);
        Self { free: Mutex::new(total), returned: Condvar::new(), total }
    }

    fn take(&self) -> Permit<'_> {
        let free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let mut free = self.returned.wait_while(free, |n| *n == 0).unwrap_or_else(PoisonError::into_inner);
        *free -= 1;
        Permit(self)
    }
}

impl Drop for Permit<'_> {
    fn drop(&mut self) {
        *self.0.free.lock().unwrap_or_else(PoisonError::into_inner) += 1;
        self.0.returned.notify_one();
    }
}

/// One call of `Task::items`.
pub(in crate::pipeline) struct Ensemble<'a> {
    pub(in crate::pipeline) store: &'a Store,
    pub(in crate::pipeline) permits: &'a Permits,
    pub(in crate::pipeline) progress: &'a dyn Progress,
    pub(in crate::pipeline) is_forced: bool,
    pub(in crate::pipeline) compute: &'a (dyn Fn(usize, &Path) -> Result<()> + Sync),
    /// Who computes several items, if not this process.
    pub(in crate::pipeline) submission: Option<Submission<'a>>,
    /// What this process computes, if it is one of those.
    pub(in crate::pipeline) shard: Option<&'a ShardRun>,
}

/// A shard that this process computes; its stage goes no farther than that.
pub(in crate::pipeline) struct ShardRun {
    pub(in crate::pipeline) shard: Shard,
    pub(in crate::pipeline) is_done: AtomicBool,
}

/// Distinct work: items with equal parameters are computed once.
pub(super) struct Job {
    index: usize,
    parts: Parts,
    pub(super) address: Address,
}

impl Ensemble<'_> {
    pub(in crate::pipeline) fn run(&self, kind: &str, version: u32, items: &[Item]) -> Result<Vec<ItemRecord>> {
        let mut addresses = Vec::with_capacity(items.len());
        let mut distinct: BTreeMap<Address, Job> = BTreeMap::new();
        for (index, item) in items.iter().enumerate() {
            let parameters = leaves(&item.parameters, &[]);
            let parts = Parts { kind: kind.into(), version, parameters, inputs: BTreeMap::new(), files: Vec::new() };
            let address = parts.address();
            addresses.push(address.clone());
            distinct.entry(address.clone()).or_insert(Job { index, parts, address });
        }
        if let Some(own) = self.shard.filter(|own| own.shard.kind == kind) {
            let jobs: Vec<Job> =
                distinct.into_values().filter(|job| own.shard.items.contains(&job.address.to_string())).collect();
            if jobs.len() < own.shard.items.len() {
                let hint = "the manifest, or the program, is another than that of the run that submitted the shard";
                return Err(Error::new("the shard has items that the stage has not").hint(hint));
            }
            self.compute_all(&jobs)?;
            own.is_done.store(true, Ordering::Relaxed);
            return Err(Error::new("the shard is done"));
        }
        let n_distinct = distinct.len();
        let mut jobs: Vec<Job> = distinct.into_values().filter(|job| !self.is_done(job)).collect();
        jobs.sort_by_key(|job| job.index);
        // Of a single item the stage itself says more.
        if n_distinct > 1 && jobs.len() < n_distinct {
            self.progress.note(&format!("{} of {n_distinct} {kind} items from the cache", n_distinct - jobs.len()));
        }
        if !jobs.is_empty() {
            self.progress.start(kind, jobs.len() as u64);
        }
        let failures = match &self.submission {
            Some(submission) if jobs.len() > 1 => submission.compute(self, kind, &jobs)?,
            _ => self.compute_all(&jobs)?,
        };
        if let Some(submission) = &self.submission {
            submission.clear(self.store, addresses.iter())?;
        }
        let record = |(item, address): (&Item, Address)| ItemRecord {
            id: item.id.clone(),
            failure: failures.get(&address).cloned(),
            entry: address.to_string(),
        };
        Ok(items.iter().zip(addresses).map(record).collect())
    }

    fn is_done(&self, job: &Job) -> bool {
        !self.is_forced && matches!(self.store.verify(&job.address), State::Sound(_))
    }

    /// Why the model has no result for some items. An `Err` is of the machine or a defect: no more items are begun.
    fn compute_all(&self, jobs: &[Job]) -> Result<BTreeMap<Address, String>> {
        let next = AtomicUsize::new(0);
        let held_elsewhere = Mutex::new(Vec::new());
        let failures = Mutex::new(BTreeMap::new());
        let finish = |job: &Job, lock: Lock| -> Result<()> {
            let outcome = self.compute_one(job, lock)?;
            if self.shard.is_some() {
                mark(&self.store.mark_path(&job.address), &outcome)?;
            }
            if let Err(failure) = outcome {
                failures.lock().unwrap_or_else(PoisonError::into_inner).insert(job.address.clone(), failure);
            }
            self.progress.advance(1);
            Ok(())
        };
        let begin = || -> Result<()> {
            while let Some(job) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
                let permit = self.permits.take();
                match Lock::try_acquire(&self.store.lock_path(&job.address))? {
                    Some(lock) => finish(job, lock)?,
                    None => held_elsewhere.lock().unwrap_or_else(PoisonError::into_inner).push(job),
                }
                drop(permit);
            }
            loop {
                let job = held_elsewhere.lock().unwrap_or_else(PoisonError::into_inner).pop();
                let Some(job) = job else { return Ok(()) };
                let lock = Lock::acquire(&self.store.lock_path(&job.address), |owner| {
                    let whom = owner.map_or(String::new(), |o| format!(" by process {} on `{}`", o.pid, o.host));
                    self.progress.note(&format!("waits for an item that is being computed{whom}"));
                })?;
                let _permit = self.permits.take();
                finish(job, lock)?;
            }
        };
        let work = || begin().inspect_err(|_| next.store(jobs.len(), Ordering::Relaxed));
        let (available, count) = (threads::available(), self.permits.total.min(jobs.len()));
        let own = || threads::sharing(available, count, work);
        std::thread::scope(|scope| {
            let workers: Vec<_> = (0..count).map(|_| scope.spawn(own)).collect();
            for worker in workers {
                worker.join().map_err(|_| Error::new("a thread of the ensemble stopped"))??;
            }
            Ok::<(), Error>(())
        })?;
        Ok(failures.into_inner().unwrap_or_else(PoisonError::into_inner))
    }

    fn compute_one(&self, job: &Job, _lock: Lock) -> Result<std::result::Result<(), String>> {
        match self.store.verify(&job.address) {
            State::Sound(_) if !self.is_forced => return Ok(Ok(())),
            State::Damaged(why) => {
                self.progress.note(&format!("`{}` is damaged ({why}) and computed again", job.address))
            }
            _ => {}
        }
        let draft = self.store.draft(&job.address)?;
        let start = Instant::now();
        if let Err(error) = guarded(|| (self.compute)(job.index, &draft.dir)) {
            crate::pipeline::files::remove_dir(&draft.dir)?;
            return if error.is_of_model() { Ok(Err(error.to_string())) } else { Err(error) };
        }
        self.store.publish(&job.parts, Vec::new(), start.elapsed().as_secs_f64())?;
        Ok(Ok(()))
    }
}

/// Runs foreign work and turns a panic into an error, so that one broken item or stage does not take the others with it.
pub(in crate::pipeline) fn guarded<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().cloned();
        let text = text.or_else(|| panic.downcast_ref::<&str>().map(ToString::to_string));
        Err(text.unwrap_or_else(|| "no message".into()))
            .context(|| "the program stopped at an assumption that does not hold (a defect)".into())
    })
}
