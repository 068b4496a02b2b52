//! Where the tests find Python.

use std::path::PathBuf;
use std::process::Command;

/// A Python that has h5py.
pub fn with_h5py() -> PathBuf {
    let chosen = std::env::var_os("STEMGEN_PYTHON").map(PathBuf::from);
    let candidates = chosen.into_iter().chain(["/usr/bin/python3".into(), "python3".into()]);
    let works = |p: &PathBuf| {
        let run = Command::new(p).args(["-c", "import h5py, numpy"]).output();
        run.is_ok_and(|o| o.status.success())
    };
    candidates
        .into_iter()
        .find(works)
        .expect("no Python with h5py: apt-get install python3-h5py, or name one in STEMGEN_PYTHON")
}
