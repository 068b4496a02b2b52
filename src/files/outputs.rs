//! Checks the paths of results before any work: paths that cannot be written are refused, and so are paths at which something of value
//! would be replaced.

use std::fs;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::setting::Setting;

/// Checks the files that a command will write. Makes their folders if they do not exist.
///
/// # Errors
/// [`Error::Invalid`] for a folder, a device or another path that is no regular file, for one of the `inputs`, for two results in one file,
/// and for an existing file unless `overwrite` is set; [`Error::Io`] if nothing can be written.
pub fn check_outputs<P: AsRef<Path>, Q: AsRef<Path>>(
    outputs: impl IntoIterator<Item = P>,
    inputs: impl IntoIterator<Item = Q>,
    overwrite: bool,
) -> Result<()> {
    let inputs: Vec<Q> = inputs.into_iter().collect();
    let read_folders: Vec<PathBuf> = inputs.iter().filter_map(whole_folder).collect();
    let read: Vec<Identity> = inputs.iter().map(|path| Identity::of(path.as_ref())).collect();
    let mut seen: Vec<Identity> = Vec::new();
    for path in outputs {
        let path = path.as_ref();
        let refuse = |why: &str| Err(Error::invalid(Setting::Output, path.display(), why));
        if path.to_str().is_none() {
            return refuse("is no text in UTF-8, which HDF5 needs; name another file");
        }
        let there = fs::metadata(path).ok();
        if there.as_ref().is_some_and(fs::Metadata::is_dir) || names_folder(path) {
            return refuse("is a folder; name a file in it, such as world.h5");
        }
        if there.as_ref().is_some_and(|m| !m.is_file()) {
            return refuse("is no regular file; name another");
        }
        if is_of_the_system(path) {
            return refuse("is a device or stream of the system, or a link to one; name a file");
        }
        let into = folder(path).canonicalize();
        if into.is_ok_and(|into| read_folders.iter().any(|read| into.starts_with(read))) {
            return refuse("lies in a folder that this command reads; name another");
        }
        let identity = Identity::of(path);
        if read.contains(&identity) {
            return refuse("is read by this command and would be replaced; name another file");
        }
        if inputs.iter().any(|input| is_unfinished_part(input.as_ref(), path)) {
            return refuse(
                "cannot be written: this command reads a file with the name of an unfinished part of it (.partial, .lock, .work); \
                 name another file",
            );
        }
        if seen.contains(&identity) {
            return refuse(
                "would be written twice, once for each of two results; name another file",
            );
        }
        seen.push(identity);
        if there.is_some() && !overwrite {
            return refuse("exists; name another file, or allow overwriting");
        }
        let folder = folder(path);
        if let Some(file) = folder.ancestors().find(|above| above.is_file()) {
            let why = format!("would lie in {}, which is a file and no folder", file.display());
            return refuse(&why);
        }
        fs::create_dir_all(folder).map_err(|e| Error::io(folder, "create", e))?;
        tempfile::tempfile_in(folder).map_err(|e| Error::io(folder, "create a file in", e))?;
    }
    Ok(())
}

/// Ending of an output's file while it is incomplete.
pub(crate) const PARTIAL: &str = ".partial";
/// Ending of the file that names the process that writes an output.
pub(crate) const LOCK: &str = ".lock";
/// Ending of the folder in which a build keeps its work until its output is complete.
const WORK: &str = ".work";

/// Ending of the note that names the command whose outputs are being put in place.
pub(crate) const UNFINISHED: &str = ".unfinished";
/// Ending of a folder that was moved aside for a file of this program.
const ASIDE: &str = ".aside";

/// Makes room for a file of this program if a folder lies at its path: an empty folder is removed, another one is renamed.
///
/// # Errors
/// [`Error::Io`].
pub(crate) fn set_aside(path: &Path) -> Result<()> {
    if !fs::symlink_metadata(path).is_ok_and(|there| there.is_dir()) || fs::remove_dir(path).is_ok()
    {
        return Ok(());
    }
    let aside = beside(path, ASIDE);
    fs::rename(path, &aside).map_err(|e| Error::io(path, "move aside", e))
}

/// Returns `path` with an ending after its name.
pub(crate) fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    PathBuf::from(name)
}

/// Returns the folder where the making of an output keeps its work until it is complete.
pub fn work_folder(output: &Path) -> PathBuf {
    beside(output, WORK)
}

/// Whether an input has the name of a file or folder that a build keeps beside `output` until it is finished, and then removes.
fn is_unfinished_part(input: &Path, output: &Path) -> bool {
    let Ok(input) = input.canonicalize() else { return false };
    let [partial, lock, work] =
        [PARTIAL, LOCK, WORK].map(|ending| beside(output, ending).canonicalize().ok());
    [partial, lock].into_iter().flatten().any(|own| own == input)
        || work.is_some_and(|work| input.starts_with(work))
}

/// Returns the folder of an input that is a folder, such as a zarr array, without links and detours.
fn whole_folder<P: AsRef<Path>>(input: P) -> Option<PathBuf> {
    input.as_ref().is_dir().then(|| input.as_ref().canonicalize().ok())?
}

/// Whether a path is a node below `/dev` or `/proc`, such as `/dev/stdout`, or a link to one. The node may lead to a regular file (`> file`
/// in a shell), but a rename would replace the node.
fn is_of_the_system(path: &Path) -> bool {
    const MOST_LINKS: usize = 40;
    let mut at = path.to_owned();
    for _ in 0..MOST_LINKS {
        let Ok(there) = folder(&at).canonicalize() else { return false };
        let memory = there.starts_with("/dev/shm");
        if there.starts_with("/proc") || (there.starts_with("/dev") && !memory) {
            return true;
        }
        match fs::read_link(&at) {
            Ok(next) => at = there.join(next),
            Err(_) => return false,
        }
    }
    true
}

/// Whether a path can only name a folder, such as `new/` or `..`.
fn names_folder(path: &Path) -> bool {
    let text = path.as_os_str().as_encoded_bytes();
    path.file_name().is_none() || text.ends_with(b"/") || text.ends_with(b"/.")
}

/// Returns the folder of a file.
pub fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// The file that a path names, by any of its names.
#[derive(PartialEq, Eq)]
enum Identity {
    /// Device, and number on the device, of an existing file.
    #[cfg(unix)]
    File(u64, u64),
    /// The path; its existing part is without links and detours.
    Path(PathBuf),
}

impl Identity {
    fn of(path: &Path) -> Self {
        #[cfg(unix)]
        if let Ok(there) = fs::metadata(path) {
            use std::os::unix::fs::MetadataExt;
            return Identity::File(there.dev(), there.ino());
        }
        let whole = path.canonicalize().ok();
        let beside = || {
            let name = path.file_name()?;
            Some(folder(path).canonicalize().ok()?.join(name))
        };
        Identity::Path(whole.or_else(beside).unwrap_or_else(|| path.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOTHING: [&Path; 0] = [];

    fn refusal(outputs: &[&Path], inputs: &[&Path], overwrite: bool) -> String {
        check_outputs(outputs, inputs, overwrite).unwrap_err().to_string()
    }

    #[test]
    fn inputs_and_other_results_are_never_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let (a, b) = (at("a.h5"), at("b.h5"));
        fs::write(&a, "a").unwrap();
        check_outputs([&b], [&a], false).unwrap();
        check_outputs([&a], NOTHING, true).unwrap();
        assert!(refusal(&[&a], &[], false).contains("exists"));
        // Other names of the file: a detour, a link.
        let detour = folder.path().join("new/../a.h5");
        fs::create_dir(at("new")).unwrap();
        assert!(refusal(&[&detour], &[&a], true).contains("is read by this command"));
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(&a, at("link.h5")).unwrap();
            assert!(refusal(&[&at("link.h5")], &[&a], true).contains("is read by this command"));
        }
        assert!(refusal(&[&b, &b], &[], true).contains("written twice"));
        let same = folder.path().join("new/../b.h5");
        assert!(refusal(&[&b, &same], &[], true).contains("written twice"));
        assert_eq!(fs::read(&a).unwrap(), b"a");
    }

    #[test]
    fn inputs_are_no_unfinished_parts_of_results() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("w.h5.work")).unwrap();
        for name in ["w.h5.partial", "w.h5.work/key.json", "w.png.lock"] {
            fs::write(at(name), "recipe").unwrap();
            let message = refusal(&[&at("w.h5"), &at("w.png")], &[&at(name)], true);
            assert!(message.contains("unfinished part"), "{name}: {message}");
        }
        fs::write(at("recipe.toml"), "").unwrap();
        check_outputs([at("w.h5")], [at("recipe.toml")], true).unwrap();
    }

    #[test]
    fn folders_and_devices_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        assert!(refusal(&[folder.path()], &[], true).contains("is a folder"));
        #[cfg(unix)]
        {
            assert!(refusal(&[Path::new("/dev/null")], &[], true).contains("no regular file"));
            // A stream that goes to a regular file: a rename would replace the link.
            let target = fs::File::create(folder.path().join("target")).unwrap();
            let stream = {
                use std::os::fd::AsRawFd;
                format!("/proc/self/fd/{}", target.as_raw_fd())
            };
            let link = folder.path().join("stream");
            std::os::unix::fs::symlink(&stream, &link).unwrap();
            for path in [Path::new(&stream), &link] {
                assert!(refusal(&[path], &[], true).contains("stream of the system"));
            }
        }
        let array = folder.path().join("a.zarr");
        fs::create_dir(&array).unwrap();
        fs::write(array.join("0.0"), "chunk").unwrap();
        assert!(
            refusal(&[&array.join("0.0")], &[&array], true).contains("that this command reads")
        );
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        let message = refusal(&[&file.join("w.h5")], &[], true);
        assert!(
            message.contains("would lie in") && message.contains("a file and no folder"),
            "{message}"
        );
        let missing = format!("{}/missing/", folder.path().display());
        let message = refusal(&[Path::new(&missing)], &[], true);
        assert!(message.contains("missing/:") && message.contains("is a folder"), "{message}");
        assert!(!folder.path().join("missing").exists());
        check_outputs([folder.path().join("deep/er/w.h5")], NOTHING, false).unwrap();
    }
}
