//! The report in a real browser, where one is installed: all sections arrive, and the page says nothing on its console.

mod report_sample;

use std::process::Command;

use flare_pipe::report;

/// Names under which the browser is installed.
const BROWSERS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];

fn browser() -> Option<&'static str> {
    BROWSERS.into_iter().find(|name| Command::new(name).arg("--version").output().is_ok_and(|out| out.status.success()))
}

#[test]
fn a_browser_shows_every_section_without_complaint() {
    let Some(browser) = browser() else {
        eprintln!("skipped: no Chromium or Chrome on the PATH, so the report was not opened in a browser");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("report.html");
    std::fs::write(&page, report::render(&report_sample::content()).unwrap()).unwrap();
    let out = Command::new(browser)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"])
        .args(["--disable-background-networking", "--disable-component-update", "--disable-sync"])
        .args(["--enable-logging=stderr", "--v=0", "--virtual-time-budget=5000"])
        .arg(format!("--user-data-dir={}", folder.path().join("profile").display()))
        .arg("--dump-dom")
        .arg(format!("file://{}", page.display()))
        .output()
        .unwrap();
    let dom = String::from_utf8_lossy(&out.stdout);
    let log = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{log}");
    for id in [
        "summary",
        "loop",
        "loop-errors",
        "loop-candidates",
        "loop-rest",
        "held-out",
        "event-6",
        "scores",
        "stage-1",
        "stage-2",
        "stage-3",
        "stage-3-2",
        "motions",
        "provenance",
    ] {
        assert!(dom.contains(&format!("id=\"{id}\"")), "section `{id}` is missing");
    }
    // Figures must survive HTML parsing inside the page, none cut off or moved out of its figure.
    assert_eq!(dom.matches("<svg").count(), dom.matches("</svg>").count());
    assert!(dom.matches("<svg").count() > 60);
    assert!(dom.trim_end().ends_with("</html>"));
    let complaints: Vec<&str> = log.lines().filter(|line| line.contains("CONSOLE")).collect();
    assert!(complaints.is_empty(), "{complaints:?}");
}
