//! Record files as users hand them in: sound ones are read in m/s², the rest is refused with file, line, value and remedy.

use flare_pipe::records::{FORMATS, Record, RecordSettings, Sensor, Split, csv, kiknet, load};
use flare_pipe::units::{AccelerationUnit, G_M_S2};
use proptest::prelude::*;
use std::path::{Path, PathBuf};

const SOUND: &str = "# a comment\ntime_s,borehole,surface\n0.00,0.010,0.03\n0.01,-0.020,-0.05\n0.02,0.005,0.02\n";

fn settings(train: &[&str], components: &[&str]) -> RecordSettings {
    let list = |names: &[&str]| names.iter().map(|n| format!("'{n}'")).collect::<Vec<_>>().join(",");
    toml::from_str(&format!(
        "format='csv'\ndir='.'\nunit='g'\ncomponents=[{}]\ntrain=[{}]\nvalidation=[]\ntest=[]",
        list(components),
        list(train)
    ))
    .unwrap()
}

fn outputs() -> Vec<String> {
    vec!["surface".to_string()]
}

/// Message of reading one file with this text.
fn refusal(text: &str) -> String {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("E1.NS.csv"), text).unwrap();
    load(&settings(&["E1"], &["NS"]), dir.path(), "borehole", &outputs()).unwrap_err().to_string()
}

#[test]
fn a_sound_file_is_read_in_si_units_with_its_step() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("E1.NS.csv"), SOUND).unwrap();
    let read = load(&settings(&["E1"], &["NS"]), dir.path(), "borehole", &outputs()).unwrap();
    let (split, record) = &read.records[0];
    assert_eq!((*split, record.dt_s, record.n_step()), (Split::Train, 0.01, 3));
    assert!((record.input.acceleration_m_s2[1] + 0.02 * G_M_S2).abs() < 1e-15);
    assert_eq!((record.input.name.as_str(), record.outputs[0].name.as_str()), ("borehole", "surface"));
    assert!(read.missing.is_empty());
}

#[test]
fn columns_are_found_by_name_in_any_order() {
    let table = csv::columns(
        "surface,extra,time_s,borehole\n3,x,0,1\n4,,0.005,2\n5,z,0.01,3\n".as_bytes(),
        &["borehole", "surface"],
        2.0,
    );
    let table = table.unwrap();
    assert_eq!((table.dt_s, table.channels), (0.005, vec![vec![2.0, 4.0, 6.0], vec![6.0, 8.0, 10.0]]));
}

#[test]
fn files_of_spreadsheets_are_read() {
    let text = format!("\u{feff}{}", "time_s,a\r\n0.00, 1.0\r\n0.01, 2.0 \r\n0.02,3\r\n\r\n");
    assert_eq!(csv::columns(text.as_bytes(), &["a"], 1.0).unwrap().channels[0], [1.0, 2.0, 3.0]);
}

#[test]
fn a_missing_component_is_listed_and_a_missing_event_refused() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("E1.NS.csv"), SOUND).unwrap();
    let read = load(&settings(&["E1"], &["NS", "EW"]), dir.path(), "borehole", &outputs()).unwrap();
    assert_eq!(read.records.len(), 1);
    assert_eq!((read.missing[0].event.as_str(), read.missing[0].component.as_str()), ("E1", "EW"));
    let error =
        load(&settings(&["E1", "E2"], &["NS", "EW"]), dir.path(), "borehole", &outputs()).unwrap_err().to_string();
    assert!(error.contains("`E2`") && error.contains("`E2.NS.csv`, `E2.EW.csv`") && error.contains("hint:"), "{error}");
    let error = load(&settings(&["E1"], &["NS"]), Path::new("/nonexistent"), "borehole", &outputs()).unwrap_err();
    assert!(error.to_string().contains("`/nonexistent`") && error.hint_text().unwrap().contains("records.dir"));
}

#[test]
fn every_fault_is_named_with_file_line_value_and_remedy() {
    let cases = [
        (SOUND.replace("-0.020", "NaN"), vec!["`borehole` is `NaN` on line 4"]),
        (SOUND.replace("-0.05", ""), vec!["`surface` is `` on line 4"]),
        (SOUND.replace("-0.05", "inf"), vec!["`surface` is `inf` on line 4"]),
        (SOUND.replace("0.02,0.005", "0.03,0.005"), vec!["time step is 0.0", "on line 5"]),
        (SOUND.replace("0.02,0.005", "0.01,0.005"), vec!["time falls from 0.01 s to 0.01 s on line 5"]),
        (SOUND.replace(",0.02\n", "\n"), vec!["line 5 has 2 values, the header has 3"]),
        (SOUND.replace("surface", "surfase"), vec!["no channel `surface`", "`surfase`", "nearest: `surfase`"]),
        (SOUND.replace("time_s", "t"), vec!["no column `time_s`"]),
        (SOUND.replace("time_s,borehole", "time_s,depth"), vec!["no channel `borehole`"]),
        (SOUND.replace("borehole,surface", "borehole,borehole"), vec!["column `borehole` comes twice"]),
        (String::new(), vec!["the file is empty"]),
        ("time_s,borehole,surface\n".into(), vec!["0 samples"]),
        (SOUND.replace("0.010,", "120.0,"), vec!["peaks at 120.000 g", "records.unit"]),
        ("time_s,borehole,surface\n0,1e-9,1\n0.01,1e-9,1\n0.02,0,1\n".into(), vec!["1.000e-9 g", "records.unit"]),
    ];
    for (text, expected) in cases {
        let message = refusal(&text);
        for part in expected {
            assert!(message.contains(part), "`{part}` is not in:\n{message}");
        }
        assert!(message.contains("E1.NS.csv") && message.contains("event `E1`, component `NS`"), "{message}");
        assert!(message.contains("\n\nhint: "), "{message}");
    }
}

#[test]
fn steps_that_print_rounds_are_accepted() {
    let text = |dt_s: f64| {
        let rows = (0..600).map(|i| format!("{:.3},1,1\n", f64::from(i) * dt_s)).collect::<String>();
        format!("time_s,a,b\n{rows}")
    };
    for dt_s in [0.01, 0.005, 1.0 / 256.0, 1.0 / 128.0] {
        let read = csv::columns(text(dt_s).as_bytes(), &["a"], 1.0).unwrap().dt_s;
        assert!((read / dt_s - 1.0).abs() < 1e-3, "{read}");
    }
    let gap = text(0.005).replace("1.500,1,1\n", "");
    assert!(csv::columns(gap.as_bytes(), &["a"], 1.0).unwrap_err().to_string().contains("on line 302"));
}

fn sample(unit_scale: f64) -> Record {
    let sensor = |name: &str, k: f64| Sensor {
        name: name.into(),
        acceleration_m_s2: (0..400).map(|i| unit_scale * k * (0.37 * f64::from(i)).sin() / 3.0).collect(),
    };
    Record {
        event: "LSST07".into(),
        component: "EW".into(),
        dt_s: 0.005,
        input: sensor("DHB17", 1.0),
        outputs: vec![sensor("DHB11", 1.5), sensor("FA1-5, top", 2.5)],
    }
}

#[test]
fn what_is_written_reads_back_the_same_in_every_unit() {
    let dir = tempfile::tempdir().unwrap();
    for (unit, name) in [
        (AccelerationUnit::MetrePerSecondSquared, "m/s2"),
        (AccelerationUnit::Gravity, "g"),
        (AccelerationUnit::Gal, "gal"),
    ] {
        let record = sample(1.0);
        let path = csv::write(dir.path(), &record, unit, &["synthetic", "two\nlines"]).unwrap();
        assert_eq!(path, dir.path().join("LSST07.EW.csv"));
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("# synthetic\n# two\n# lines\ntime_s,DHB17,DHB11,\"FA1-5, top\"\n0,"), "{text}");
        assert!(text.contains("\n0.015,"));
        let mut wanted = settings(&["LSST07"], &["EW"]);
        wanted.unit = Some(unit);
        let names = vec!["DHB11".to_string(), "FA1-5, top".to_string()];
        let read = load(&wanted, dir.path(), "DHB17", &names).unwrap().records.remove(0).1;
        assert_eq!(read.dt_s, 0.005, "{name}");
        for (a, b) in read.sensors().zip(record.sensors()) {
            for (x, y) in a.acceleration_m_s2.iter().zip(&b.acceleration_m_s2) {
                assert!((x - y).abs() <= 2e-16 * y.abs(), "{name}: {x} {y}");
            }
        }
    }
}

fn kiknet_text(counts: &[i32], stated_gal: f64) -> String {
    let mut text = String::new();
    for (label, value) in [
        ("Origin Time", "2024/01/01 16:10:00"),
        ("Lat.", "37.495"),
        ("Long.", "137.270"),
        ("Depth. (km)", "16"),
        ("Mag.", "7.6"),
        ("Station Code", "NIGH18"),
        ("Station Lat.", "36.9425"),
        ("Station Long.", "138.2594"),
        ("Station Height(m)", "130"),
        ("Record Time", "2024/01/01 16:08:45"),
        ("Sampling Freq(Hz)", "100Hz"),
        ("Duration Time(s)", "0"),
        ("Dir.", "1"),
        ("Scale Factor", "3923(gal)/8224838"),
        ("Max. Acc. (gal)", &stated_gal.to_string()),
        ("Last Correction", "2024/01/01 16:08:46"),
        ("Memo.", ""),
    ] {
        text += &format!("{label:<18}{value}\n");
    }
    for row in counts.chunks(8) {
        text += &row.iter().map(|c| format!("{c:>9}")).collect::<String>();
        text += "\n";
    }
    text
}

#[test]
fn kiknet_counts_become_accelerations_without_their_mean() {
    let counts = [-11000, -11000, 9000, -11000, -31000, -11000, -11000, -11000, -11000];
    let peak_gal = 20000.0 * 3923.0 / 8224838.0;
    let channel = kiknet::parse(&kiknet_text(&counts, peak_gal)).unwrap();
    assert_eq!((channel.dt_s, channel.station.as_str()), (0.01, "NIGH18"));
    assert!((channel.acceleration_m_s2[2] - 0.01 * peak_gal).abs() < 1e-12);
    assert!(channel.acceleration_m_s2.iter().sum::<f64>().abs() < 1e-12);
}

#[test]
fn kiknet_faults_name_the_line() {
    let counts = [0, 20000, -20000, 0];
    let sound = kiknet_text(&counts, 20000.0 * 3923.0 / 8224838.0);
    let cases = [
        (sound.replace("100Hz", "abc"), "line 11"),
        (sound.replace("3923(gal)/8224838", "3923(gal)"), "line 14"),
        (sound.replace("Scale Factor", "Scale Foctor"), "line 14 must start with `Scale Factor`"),
        (sound.replace("-20000", "x20000"), "line 18 must hold integer counts, got `x20000`"),
        (sound.replace("-20000", " 20000"), "counts peak at"),
        (
            sound.replace("Duration Time(s)  0", "Duration Time(s)  300"),
            "the file has 4 counts, 300 s at 100 Hz are 30000",
        ),
        (sound.lines().take(17).collect::<Vec<_>>().join("\n"), "the file has 17 lines"),
        (String::new(), "the file has 0 lines"),
    ];
    for (text, expected) in cases {
        let error = kiknet::parse(&text).unwrap_err();
        assert!(error.to_string().contains(expected) && error.hint_text().is_some(), "`{expected}` not in {error}");
    }
}

#[test]
fn formats_refuse_unknown_options() {
    for entry in FORMATS {
        let table: toml::Table = toml::from_str("frobnicate = 1").unwrap();
        assert!((entry.build)(table).is_err(), "{}", entry.name);
        assert!((entry.build)(toml::Table::new()).is_ok());
    }
}

proptest! {
    #[test]
    fn any_csv_text_is_read_or_refused(text in "[0-9a-z_.,#\"\r\n -]{0,200}") {
        let _ = csv::columns(format!("time_s,a\n{text}").as_bytes(), &["a"], 1.0);
        let _ = csv::columns(text.as_bytes(), &["a"], 1.0);
    }

    #[test]
    fn any_bytes_are_refused_without_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = csv::columns(bytes.as_slice(), &["time_s"], 1.0);
        let _ = kiknet::parse(&String::from_utf8_lossy(&bytes));
    }

    #[test]
    fn any_damage_to_a_kiknet_file_is_read_or_refused(line in 0usize..19, with in "\\PC{0,30}") {
        let text = kiknet_text(&[1, 2, 3, -4, 5, 6, 7, 8, 9], 0.003);
        let damaged: Vec<&str> = text.lines().enumerate().map(|(i, l)| if i == line { with.as_str() } else { l }).collect();
        let _ = kiknet::parse(&damaged.join("\n"));
    }
}

/// The folder of measured records beside the repository, if it is there.
fn measured(folder: &str) -> Option<PathBuf> {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/records").join(folder);
    let dir = if dir.is_dir() {
        Some(dir)
    } else {
        std::env::var_os("FLARE_PIPE_RECORDS").map(|d| Path::new(&d).join(folder))
    };
    let found = dir.filter(|d| d.is_dir());
    if found.is_none() {
        println!("skipped: no folder `../shared/records/{folder}` (or set FLARE_PIPE_RECORDS)");
    }
    found
}

#[test]
fn all_fksh11_records_are_read_as_they_are() {
    let Some(dir) = measured("FKSH11") else { return };
    let events = [
        "0401231801",
        "0510192044",
        "0805080145",
        "1006131233",
        "1103122215",
        "1103191856",
        "1103221819",
        "1103230712",
        "2102132308",
        "1104111726",
        "1104121415",
        "1104111716",
        "2203162336",
    ];
    let read = load(&settings(&events, &["NS", "EW"]), &dir, "borehole", &outputs()).unwrap();
    assert_eq!(read.records.len(), 25);
    assert_eq!((read.missing[0].event.as_str(), read.missing[0].component.as_str()), ("2203162336", "EW"));
    for (_, r) in &read.records {
        let expected_s = if ["0401231801", "0510192044"].contains(&r.event.as_str()) { 0.005 } else { 0.01 };
        assert_eq!(r.dt_s, expected_s, "{}", r.event);
        let pga_g = r.input_pga_m_s2() / G_M_S2;
        assert!((0.005..0.16).contains(&pga_g), "{} {}: {pga_g} g", r.event, r.component);
        let coarse = r.resampled(0.05);
        assert!(coarse.sensors().all(|s| s.acceleration_m_s2.iter().all(|v| v.is_finite())));
    }
}

#[test]
fn the_raw_kiknet_event_is_read_and_agrees_with_its_stated_peaks() {
    let Some(dir) = measured("kiknet-ascii") else { return };
    let mut wanted = settings(&["2401011610"], &["NS", "EW"]);
    wanted.format = "kiknet".into();
    wanted.options = toml::from_str("station = 'NIGH18'").unwrap();
    let refused = load(&wanted, &dir, "borehole", &outputs()).unwrap_err().to_string();
    assert!(refused.contains("records.unit = \"gal\""), "{refused}");
    wanted.unit = Some(AccelerationUnit::Gal);
    let read = load(&wanted, &dir, "borehole", &outputs()).unwrap();
    assert_eq!(read.records.len(), 2);
    let ns = &read.records[0].1;
    assert_eq!((ns.dt_s, ns.n_step()), (0.01, 30_000));
    assert!((ns.input_pga_m_s2() - 0.51045).abs() < 1e-4);
    wanted.components = vec!["UD".into()];
    let vertical = load(&wanted, &dir, "borehole", &outputs()).unwrap_err();
    assert!(vertical.to_string().contains("is vertical") && vertical.hint_text().unwrap().contains("horizontal"));
}

#[test]
fn a_truth_on_measured_records_changes_what_its_sensor_recorded_and_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    let wave = |t: f64, f: f64| 0.1 * (f * t).sin() * (-((t - 2.0) / 0.5).powi(2)).exp();
    for (component, f) in [("NS", 20.0), ("EW", 31.0)] {
        let lines: String = (0..400)
            .map(|i| i as f64 * 0.01)
            .map(|t| format!("{t:.2},{},{}\n", wave(t, f), 2.0 * wave(t - 0.2, f)))
            .collect();
        std::fs::write(dir.path().join(format!("E1.{component}.csv")), format!("time_s,borehole,surface\n{lines}"))
            .unwrap();
    }
    let site = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/fksh11.toml");
    let manifest = flare_pipe::manifest::Manifest::load(&site, &[]).unwrap();
    let sections = manifest.site.column();
    let altered = |truth: &str| {
        let path = dir.path().join("truth.toml");
        std::fs::write(&path, format!("site = 'x.toml'\nseed = 1\n{truth}")).unwrap();
        let text = |p: &Path| Some(p.display().to_string());
        let settings = RecordSettings { dir: text(dir.path()), truth: text(&path), ..settings(&["E1"], &["NS", "EW"]) };
        flare_pipe::stages::measured(&settings, &sections)
            .map(|read| read.records.into_iter().map(|(_, r)| r).collect::<Vec<Record>>())
    };
    let [plain, turned] = ["", "[[effects]]\nkind = 'sensor_orientation'\nsensor = 'surface'\nazimuth_deg = 90.0\n"]
        .map(|t| altered(t).unwrap());
    for (plain, turned) in plain.iter().zip(&turned) {
        assert_eq!(plain.input, turned.input);
    }
    let surface = |records: &[Record], c: usize| records[c].outputs[0].acceleration_m_s2.clone();
    for (one, other) in surface(&turned, 0).iter().zip(surface(&plain, 1)) {
        assert!((one - other).abs() < 1e-3, "a quarter turn records the other component");
    }
    for refused in [
        "[[effects]]\nkind = 'small_strain_damping'\nmultiplier = 2.0\n",
        "[[event]]\nname = 'E1'\npga_g = { NS = 0.1 }\nduration_s = 10.0\n",
    ] {
        assert!(altered(refused).unwrap_err().to_string().contains("measured"));
    }
    let nowhere = "[[effects]]\nkind = 'sensor_gain'\nsensor = 'roof'\nln_gain = 0.1\n";
    assert!(altered(nowhere).unwrap_err().to_string().contains("roof"));
}
