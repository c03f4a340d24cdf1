//! The program in a folder that holds nothing but a user's own files.

use assert_cmd::Command;
use std::fs;
use std::io::Read;
use std::path::Path;
use std::process::Stdio;

const CONFIGS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/configs");

fn flare_pipe(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::cargo_bin("flare-pipe").expect("the program is built");
    command.current_dir(folder).args(arguments);
    command
}

/// Runs in `folder` and returns exit status, stdout and stderr.
fn said(folder: &Path, arguments: &[&str]) -> (i32, String, String) {
    let output = flare_pipe(folder, arguments).output().expect("the program starts");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code().unwrap_or(-1), text(&output.stdout), text(&output.stderr))
}

/// A folder with a site whose records a truth computes.
fn site() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let truth = format!("{CONFIGS}/truth/smoke.toml");
    let text = fs::read_to_string(format!("{CONFIGS}/smoke.toml")).expect("a manifest");
    fs::write(folder.path().join("own.toml"), text.replace("truth/smoke.toml", &truth)).expect("written");
    folder
}

/// A profile, and records of three events at two depths, in g.
fn measurements() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let records = folder.path().join("records");
    fs::create_dir(&records).expect("made");
    fs::write(folder.path().join("profile.csv"), "thickness_m,vs_m_s,density_kg_m3\n4,130,1900\n6,180,1950\n")
        .expect("written");
    for (i, event) in ["2019-03-11", "2020-01-05", "2021-07-30"].iter().enumerate() {
        let row = |k: u32| {
            let t = f64::from(k) * 0.01;
            let wave = |lag: f64| 0.02 * (i as f64 + 1.0) * (9.0 * (t - lag)).sin() * (-(t - 6.0) * (t - 6.0)).exp();
            format!("{t:.2},{},{}\n", wave(0.0), 2.0 * wave(0.1))
        };
        let rows: String = (0..1500).map(row).collect();
        fs::write(records.join(format!("{event}.EW.csv")), format!("# unit: g\ntime_s,G10,G0\n{rows}"))
            .expect("written");
    }
    folder
}

const INIT: [&str; 10] =
    ["init", "mine", "--profile", "profile.csv", "--records", "records", "--sensor", "G10=10", "--sensor", "G0=0"];

#[test]
fn pipelines_come_with_the_program_and_results_lie_beside_the_manifest() {
    let folder = site();
    let here = folder.path();
    let (status, _, stderr) = said(here, &["check", "own.toml"]);
    assert!(status == 0 && stderr.contains("close-loop (built in)"), "{stderr}");
    let elsewhere = tempfile::tempdir().expect("a folder");
    let manifest = here.join("own.toml").display().to_string();
    let (status, _, stderr) = said(elsewhere.path(), &["run", &manifest, "--only", "records"]);
    assert_eq!(status, 0, "{stderr}");
    assert!(here.join("runs/smoke/last.toml").is_file(), "{stderr}");
    let (status, stdout, _) = said(here, &["status", "own.toml"]);
    assert!(status == 0 && stdout.lines().any(|l| l.starts_with("records ") && l.contains("cached")), "{stdout}");
    fs::create_dir(here.join("pipelines")).expect("made");
    fs::write(here.join("pipelines/close-loop.toml"), "about = 'own'\n[[stage]]\nname = 'records'\n").expect("written");
    let (status, stdout, stderr) = said(here, &["plan", "own.toml"]);
    assert!(status == 0 && stdout.lines().count() == 1 && stderr.contains("pipelines/close-loop.toml"), "{stderr}");
}

#[test]
fn a_profile_and_records_make_a_manifest_that_checks() {
    let folder = measurements();
    let here = folder.path();
    let (status, stdout, stderr) = said(here, &INIT);
    assert_eq!((status, stdout.trim()), (0, "mine.toml"), "{stderr}");
    let (status, _, stderr) = said(here, &["check", "mine.toml"]);
    assert_eq!(status, 0, "{stderr}");
    for part in ["2 layers over 10 m", "3 events", "diagnose (built in)", "ten elements in a wavelength"] {
        assert!(stderr.contains(part), "`{part}` in\n{stderr}");
    }
    let (status, stdout, stderr) = said(here, &["records", "mine.toml", "--json"]);
    assert_eq!(status, 0, "{stderr}");
    let rows: serde_json::Value = serde_json::from_str(&stdout).expect("JSON");
    let peak = rows[0]["peak_m_s2"]["G10"].as_f64().expect("a number");
    assert!((peak / (0.02 * 9.806_65) - 1.0).abs() < 0.02, "{peak} m/s²");
    let (status, _, stderr) = said(here, &INIT);
    assert!(status == 2 && stderr.contains("`mine.toml` is there already"), "{stderr}");
    let (status, _, stderr) = said(here, &["init", "other", "--profile", "profile.csv", "--records", "records"]);
    assert!(status == 2 && stderr.contains("--sensor G10=… --sensor G0=…"), "{stderr}");
}

#[test]
fn records_alone_make_a_manifest_that_checks_and_says_what_is_a_guess() {
    let folder = measurements();
    let here = folder.path();
    let init = ["init", "mine", "--records", "records", "--sensor", "G10=10", "--sensor", "G0=0"];
    let (status, _, stderr) = said(here, &init);
    assert_eq!(status, 0, "{stderr}");
    let manifest = fs::read_to_string(here.join("mine.toml")).unwrap();
    assert!(manifest.contains("vs_m_s = 300.0 # ? no profile was given"), "{manifest}");
    let (status, _, stderr) = said(here, &["check", "mine.toml"]);
    assert_eq!(status, 0, "{stderr}");
    let (status, _, stderr) = said(here, &["init", "other"]);
    assert!(status == 2 && stderr.contains("--profile <FILE>"), "{stderr}");
}

#[test]
fn records_of_an_agency_make_a_manifest_that_checks() {
    let folder = measurements();
    let here = folder.path();
    let agency = here.join("agency");
    fs::create_dir(&agency).expect("a folder");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/record_formats/20210301_cosmos.v2");
    for event in ["2021-03-01", "2021-03-02", "2021-03-03"] {
        fs::copy(&source, agency.join(format!("{event}.v2"))).expect("copied");
    }
    let init = ["init", "array", "--profile", "profile.csv", "--records", "agency"];
    let (status, _, stderr) = said(here, &init);
    assert!(status == 2 && stderr.contains("--channel SENSOR.COMPONENT=NAME"), "{stderr}");
    assert!(stderr.contains("`2021-03-01.v2:3` (20°"), "{stderr}");
    let channels = ["base.NS=1", "base.EW=2", "top.NS=3", "top.EW=4"].iter().flat_map(|c| ["--channel", *c]);
    let depths = ["base=10", "top=0"].iter().flat_map(|d| ["--sensor", *d]);
    let init: Vec<&str> = init.into_iter().chain(channels).chain(depths).collect();
    let (status, _, stderr) = said(here, &init);
    assert_eq!(status, 0, "{stderr}");
    let (status, _, stderr) = said(here, &["check", "array.toml"]);
    assert!(status == 0 && stderr.contains("`2021-03-01.v2:3` turned from 20° to 0°"), "{stderr}");
    let (_, stdout, _) = said(here, &["records", "array.toml"]);
    assert!(stdout.contains("2021-03-01T07:30:15") && stdout.contains("0.449"), "{stdout}");
}

#[test]
fn every_fault_of_every_record_is_told_before_anything_runs() {
    let folder = measurements();
    let here = folder.path();
    assert_eq!(said(here, &INIT).0, 0);
    let path = |event: &str| here.join(format!("records/{event}.EW.csv"));
    let change = |event: &str, from: &str, to: &str| {
        let text = fs::read_to_string(path(event)).expect("a record");
        fs::write(path(event), text.replacen(from, to, 1)).expect("written");
    };
    change("2019-03-11", "\n7.00,", "\n7.00,nan,");
    change("2020-01-05", "time_s,G10", "time_s,G11");
    fs::remove_file(path("2021-07-30")).expect("removed");
    let (status, _, stderr) = said(here, &["check", "mine.toml"]);
    assert_eq!(status, 2);
    for part in ["2019-03-11.EW.csv", "no channel `G10`", "`2021-07-30.EW.csv` is in", "3 problems"] {
        assert!(stderr.contains(part), "`{part}` in\n{stderr}");
    }
    change("2020-01-05", "# unit: g\n", "");
    let (_, _, stderr) = said(here, &["check", "mine.toml"]);
    assert!(stderr.contains("nothing says in what unit"), "{stderr}");
    change("2020-01-05", "time_s", "# unit: gal\ntime_s");
    let (_, _, stderr) = said(here, &["check", "mine.toml", "--set", "records.unit=g"]);
    assert!(stderr.contains("the file says that it is in gal, but g is declared"), "{stderr}");
}

#[test]
fn errors_are_json_where_that_is_asked_for() {
    let folder = site();
    let (status, stdout, stderr) = said(folder.path(), &["check", "absent.toml", "--json"]);
    assert_eq!((status, stderr.as_str()), (2, ""));
    let found: serde_json::Value = serde_json::from_str(&stdout).expect("JSON");
    assert!(found["error"]["what"].as_str().is_some_and(|what| what.contains("absent.toml")), "{stdout}");
    for command in ["check", "status", "graph", "plan"] {
        let (status, stdout, stderr) = said(folder.path(), &[command, "own.toml", "--json"]);
        assert_eq!(status, 0, "{stderr}");
        assert!(serde_json::from_str::<serde_json::Value>(&stdout).is_ok(), "{command}: {stdout}");
    }
}

#[test]
fn a_reader_who_has_seen_enough_is_no_failure() {
    let folder = site();
    for arguments in [&["plan", "own.toml"][..], &["list", "effects"], &["schema"]] {
        let mut child = std::process::Command::new(assert_cmd::cargo::cargo_bin("flare-pipe"))
            .current_dir(folder.path())
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        drop(child.stdout.take());
        let status = child.wait().expect("it ends");
        let mut stderr = String::new();
        child.stderr.take().expect("piped").read_to_string(&mut stderr).expect("text");
        assert!(status.success() && !stderr.contains("panicked"), "{arguments:?}: {stderr}");
    }
}

#[test]
fn layers_count_from_one_everywhere() {
    let folder = site();
    let here = folder.path();
    assert_eq!(said(here, &["run", "own.toml", "--only", "records", "--only", "replay"]).0, 0);
    let (_, stdout, _) = said(here, &["plan", "own.toml", "--set", "site.layer[1].vs_m_s=140"]);
    assert!(stdout.contains("`site.layer[1].vs_m_s`: 130.0 → 140.0"), "{stdout}");
    let (status, _, stderr) = said(here, &["check", "own.toml", "--set", "site.layer[1].vs_m_s=-5"]);
    assert!(status == 2 && stderr.contains("20…5000 m/s, got -5"), "{stderr}");
    for beyond in ["site.layer[0].vs_m_s=140", "site.layer[3].vs_m_s=140"] {
        let (status, _, stderr) = said(here, &["check", "own.toml", "--set", beyond]);
        assert!(status == 2 && stderr.contains("there are 2 of these, counted from 1"), "{stderr}");
    }
}

/// What the README says of a site of one's own, command by command, in a folder that holds nothing but a profile and records.
#[test]
fn the_five_minutes_of_the_readme_end_with_an_answer() {
    let folder = tempfile::tempdir().expect("a folder");
    let here = folder.path();
    let truth = format!("{CONFIGS}/truth/smoke-null.toml");
    assert_eq!(said(here, &["twin", &truth, "-o", "recorded"]).0, 0);
    fs::create_dir(here.join("records")).expect("made");
    fs::write(here.join("profile.csv"), "thickness_m,vs_m_s,density_kg_m3\n4,130,1900\n6,180,1950\n").expect("written");
    for file in here.join("recorded").read_dir().expect("records").map(|file| file.expect("a record").path()) {
        let text = fs::read_to_string(&file).expect("a record");
        let mut rows =
            text.lines().filter(|line| !line.starts_with('#')).map(|line| line.split(',').collect::<Vec<_>>());
        assert_eq!(rows.next().expect("a header"), ["time_s", "base", "middle", "surface"]);
        let rows: String = rows.map(|cells| format!("{},{},{}\n", cells[0], cells[1], cells[3])).collect();
        let path = here.join("records").join(file.file_name().expect("a name"));
        fs::write(path, format!("# unit: m/s2\ntime_s,G10,G0\n{rows}")).expect("written");
    }
    let readme = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/README.md")).expect("a README");
    let section = readme.split("\n## ").find(|text| text.starts_with("Five minutes")).expect("the section");
    let commands: Vec<&str> = section.lines().filter_map(|line| line.strip_prefix("    flare-pipe ")).collect();
    assert_eq!(commands.len(), 5);
    for command in commands {
        let words: Vec<&str> = command.split('#').next().unwrap_or_default().split_whitespace().collect();
        let (status, _, stderr) = said(here, &words);
        assert_eq!(status, 0, "{command}\n{stderr}");
        if words[0] == "run" {
            assert!(stderr.contains("Response spectra of held-out events") && stderr.contains("Next: "), "{stderr}");
        }
    }
    let found = fs::read_to_string(here.join("runs/mysite/loop.json")).expect("an answer");
    let found: serde_json::Value = serde_json::from_str(&found).expect("JSON");
    let verdict = found["verdict"].as_str().expect("a verdict");
    assert!(["none", "known", "ambiguous", "unknown"].contains(&verdict));
    for file in ["runs/mysite/report.html", "out/histories.csv", "out/errors.csv", "out/figures/loop-errors-1.svg"] {
        assert!(fs::metadata(here.join(file)).expect(file).len() > 1000, "{file}");
    }
}
