//! The memory that a training may take for its data.

use crate::error::Result;
use crate::flare::Training;
use crate::manifest::TrainingSection;
use crate::numerics::spill::Spill;
use crate::pipeline::Task;

/// What stages that keep learning data have unkeyed: whatever it is, their output is the same.
pub const UNKEYED: &[&str] = &["training.memory_gib"];

/// Where a stage keeps learning data: as `[training]` says in memory, and what is more beside its state.
///
/// # Errors
/// When the section is of another type, or there is no folder for its state.
pub fn spill(task: &Task<'_>) -> Result<Spill> {
    let section: TrainingSection = task.section("training")?;
    Ok(Spill::new(section.memory_bytes(machine_bytes()) as usize, task.checkpoint_dir()?))
}

/// What a training of `task` is given.
///
/// # Errors
/// As [`spill`].
pub fn training<'a>(task: &'a Task<'_>) -> Result<Training<'a>> {
    Ok(Training { checkpoint_dir: Some(task.checkpoint_dir()?), spill: spill(task)?, progress: task.progress() })
}

/// Memory of this machine, or of what holds this process, bytes; none where it is not said.
pub fn machine_bytes() -> Option<f64> {
    let text = |path: &str| std::fs::read_to_string(path).ok();
    let total_kib = text("/proc/meminfo")?
        .lines()
        .find_map(|line| line.strip_prefix("MemTotal:")?.trim().trim_end_matches("kB").trim().parse::<f64>().ok())?;
    let held = text("/sys/fs/cgroup/memory.max").and_then(|text| text.trim().parse::<f64>().ok());
    Some(held.unwrap_or(f64::INFINITY).min(1024.0 * total_kib))
}
