//! How work grows with what is asked for: threads, trajectories, sites and shards of a cluster, and what doing nothing costs.
//!
//! `cargo bench --bench scaling`, with `-- 100 1000 10000` for these numbers of trajectories, prints a table for
//! `src/pipeline/measured.md`. One sitting on one machine; ratios are to the first row of each part. Shards are run where a Slurm answers
//! (`tests/slurm/start` starts one here).

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

const PIPELINE: &str = r#"
about = "trajectories alone"
[[stage]]
name = "motions"
[[stage]]
name = "simulate"
inputs = { motions = "motions" }
"#;
/// Trajectories of the parts in which their number is not what changes.
const TRAJECTORIES: usize = 400;
/// Trajectories of each site.
const OF_A_SITE: usize = 20;

/// A folder with the manifest of the small site, and what is run there.
struct Bench {
    place: PathBuf,
}

impl Bench {
    /// Wall time, s, of a command that must succeed.
    fn seconds(&self, arguments: &[&str]) -> f64 {
        let start = Instant::now();
        let mut command = Command::new(env!("CARGO_BIN_EXE_flare-pipe"));
        let out = command.current_dir(&self.place).args(arguments).stdin(Stdio::null()).output().expect("it starts");
        assert!(out.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&out.stderr));
        start.elapsed().as_secs_f64()
    }

    /// The same with an ensemble of `count` trajectories in `folder`.
    fn ensemble(&self, command: &str, folder: &str, count: usize, more: &[&str]) -> f64 {
        let train = count * 4 / 5;
        let settings = [
            format!("motions.count={count}"),
            format!("motions.bands=[{{count={count},min_pga_g=0.01,max_pga_g=0.1}}]"),
            format!("motions.train=\"1-{train}\""),
            format!("motions.validation=\"{}-{count}\"", train + 1),
        ];
        let mut arguments = vec![command, "smoke.toml", "--pipeline", "ensemble", "--run-dir", folder];
        settings.iter().for_each(|setting| arguments.extend(["--set", setting]));
        self.seconds(&[&arguments, more].concat())
    }
}

/// Bytes and number of the files below a folder.
fn size(folder: &Path) -> [u64; 2] {
    let of = |entry: fs::DirEntry| match entry.metadata() {
        Ok(metadata) if metadata.is_dir() => size(&entry.path()),
        Ok(metadata) => [metadata.len(), 1],
        Err(_) => [0, 0],
    };
    let entries = fs::read_dir(folder).into_iter().flatten().flatten().map(of);
    entries.fold([0, 0], |[bytes, files], [b, f]| [bytes + b, files + f])
}

/// One part of the table.
#[derive(Default)]
struct Part {
    text: String,
    first: Option<(f64, f64)>,
}

impl Part {
    fn row(&mut self, what: &str, number: usize, seconds: f64, stored: Option<[u64; 2]>) {
        let number = number as f64;
        let (first, first_s) = *self.first.get_or_insert((number, seconds));
        let stored = stored.map_or(String::new(), |[b, files]| format!("{:.0} MB in {files} files", b as f64 / 1e6));
        let ratio = format!("{:.2} for {:.0} times as many", seconds / first_s, number / first);
        writeln!(self.text, "| {what} | {number} | {seconds:.2} | {ratio} | {stored} |").expect("a string");
    }
}

fn main() {
    let asked: Vec<usize> = std::env::args().skip(1).filter_map(|text| text.parse().ok()).collect();
    let counts = if asked.is_empty() { vec![100, 1000] } else { asked };
    let folder = tempfile::tempdir().expect("a folder");
    let bench = Bench { place: folder.path().into() };
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs");
    fs::create_dir_all(bench.place.join("pipelines")).expect("made");
    fs::write(bench.place.join("pipelines/ensemble.toml"), PIPELINE).expect("written");
    fs::copy(configs.join("smoke.toml"), bench.place.join("smoke.toml")).expect("copied");

    println!("| what | number | time, s | ratio | stored |\n|---|---|---|---|---|");
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let mut part = Part::default();
    for jobs in std::iter::successors(Some(1), |n| Some(2 * n)).take_while(|n| *n <= cores) {
        let folder = format!("threads{jobs}");
        let seconds = bench.ensemble("run", &folder, TRAJECTORIES, &["-q", "--jobs", &jobs.to_string()]);
        part.row(&format!("threads, {TRAJECTORIES} trajectories"), jobs, seconds, None);
    }
    print!("{}", part.text);

    let [mut run, mut again, mut status] = [Part::default(), Part::default(), Part::default()];
    for count in counts {
        let folder = format!("n{count}");
        let seconds = bench.ensemble("run", &folder, count, &["-q"]);
        run.row("trajectories", count, seconds, Some(size(&bench.place.join(&folder).join("cache"))));
        again.row("nothing to do", count, bench.ensemble("run", &folder, count, &["-q"]), None);
        status.row("`status`", count, bench.ensemble("status", &folder, count, &[]), None);
    }
    [run, again, status].iter().for_each(|part| print!("{}", part.text));

    let [mut run, mut again] = [Part::default(), Part::default()];
    for sites in [5, 50] {
        let mut table = String::from("site,name,motions.seed,randomisation.seed\n");
        for i in 1..=sites {
            writeln!(table, "smoke.toml,site-{sites}-{i},{i},{i}").expect("a string");
        }
        let (name, folder) = (format!("sites{sites}.csv"), format!("fleet{sites}"));
        fs::write(bench.place.join(&name), table).expect("written");
        let arguments = ["fleet", &name, "--pipeline", "ensemble", "--run-dir", &folder];
        let seconds = bench.seconds(&arguments);
        let what = format!("sites of {OF_A_SITE} trajectories");
        run.row(&what, sites, seconds, Some(size(&bench.place.join(&folder).join("cache"))));
        again.row("nothing to do for sites", sites, bench.seconds(&arguments), None);
    }
    [run, again].iter().for_each(|part| print!("{}", part.text));

    let mut part = Part::default();
    if Command::new("squeue").stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok_and(|s| s.success()) {
        for shards in [1, 4, 16] {
            let (folder, items) = (format!("shards{shards}"), TRAJECTORIES.div_ceil(shards));
            let items = format!("executor.slurm.shard_items={items}");
            let more = ["-q", "--executor", "slurm", "--set", &items];
            let seconds = bench.ensemble("run", &folder, TRAJECTORIES, &more);
            part.row(&format!("shards, {TRAJECTORIES} trajectories"), shards, seconds, None);
        }
    } else {
        println!("| shards | no Slurm answers | | | |");
    }
    print!("{}", part.text);
}
