//! Series of a specimen that loses atoms.

use super::{fails, json, python, stemgen};

const SERIES: [&str; 13] = [
    "live",
    "test",
    "--no-cache",
    "--set",
    "field.thickness_nm=0.4",
    "--set",
    "boundaries.count=0",
    "--set",
    "damage.radiolysis_barn.O=20",
    "--grid",
    "1x1",
    "--dose-series",
    "3",
];

#[test]
fn a_series_shows_what_it_takes_away() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let printed = json(
        stemgen(here)
            .args(SERIES)
            .args(["--at", "1.9,1.9", "--zoom", "2", "--dose", "2e5", "--profile", "routine"])
            .args(["--frame-s", "0.5", "-o", "s.h5", "--animation", "--quiet"]),
    );
    assert_eq!(printed["recordings"], 3);
    assert!(printed["lost"]["O"].as_u64().unwrap() > 3, "{printed}");
    assert_eq!(printed["history"].as_array().unwrap().len(), 3);
    python("check_series.py", &[&here.join("s.h5"), &here.join("s.png")]);
}

#[test]
fn nothing_lost_is_said_and_nonsense_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let printed = fails(stemgen(here).args(["live", "test", "-o", "s.png"]));
    assert!(printed.contains("s.h5"), "{printed}");
    let printed = fails(stemgen(here).args(SERIES).args([
        "--dose",
        "1e5",
        "--animation",
        "--frame-s",
        "100",
        "-o",
        "s.h5",
    ]));
    assert!(printed.contains("--frame-s 100: write 0.01 to 60 seconds"), "{printed}");
    assert!(!here.join("s.h5").exists());
    let printed = fails(
        stemgen(here)
            .args([&SERIES[..], &["--dose", "1e5", "--most-dose", "1e5", "-o", "s.h5"]].concat()),
    );
    assert!(
        printed.contains("the dose of the whole series is")
            && printed.contains("larger --most-dose"),
        "{printed}"
    );
    let printed = fails(stemgen(here).args([
        "live",
        "test",
        "--dose-series",
        "0",
        "--no-cache",
        "-o",
        "s.h5",
        "--set",
        "field.thickness_nm=0.4",
        "--grid",
        "1x1",
    ]));
    assert!(printed.contains("--dose-series"), "{printed}");
    let printed = fails(stemgen(here).args([
        "live",
        "test",
        "--set",
        "damage.threshold_ev.Xx=3",
        "-o",
        "s.h5",
    ]));
    assert!(
        printed.contains("damage.threshold_ev") && printed.contains("element of the crystal"),
        "{printed}"
    );
    assert!(!here.join("s.h5").exists());
}

/// No option that the help lists is refused for being there; a plan says what the library takes, and writes nothing.
#[test]
fn a_plan_says_what_the_library_takes() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let plan = json(stemgen(here).args(SERIES).args(["-o", "s.h5", "--dry-run", "--no-library"]));
    assert_eq!((&plan["recordings"], &plan["shape"][0]), (&3.into(), &128.into()), "{plan}");
    let image = &plan["image"];
    assert!(image["library"]["missing"].as_u64().unwrap() > 0, "{plan}");
    let [least, most] = [0, 1].map(|k| image["estimated_range_s"][k].as_f64().unwrap());
    assert!(0.0 < least && least < most, "{plan}");
    let mut again = stemgen(here);
    again.args(SERIES).args(["-o", "s.h5", "--dry-run", "--no-library"]);
    let words = super::stdout(&again.output().unwrap());
    for part in ["to simulate first", "time ", "nothing was simulated or written"] {
        assert!(words.contains(part), "no `{part}` in {words}");
    }
    assert!(!here.join("s.h5").exists());
}
