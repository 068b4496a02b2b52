//! Audits on disk, so that an interrupted build that is run again reads the audits that it has made.

use std::fs;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::options::AuditOptions;
use super::region_audit::{Audit, audit};
use crate::error::{Error, Result};
use crate::files::atomic_write;
use crate::imaging::region_imager::RegionImager;
use crate::numerics::NUMERICS_VERSION;
use crate::progress::Progress;
use crate::recipe::Recipe;
use crate::specimen::Specimen;

const EXTENSION: &str = "audit";

/// A folder of audits. Without a folder, nothing is kept.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct KeptAudits {
    folder: Option<PathBuf>,
}

impl KeptAudits {
    /// Keeps audits in a folder, which is made at the first write.
    pub(crate) fn at(folder: PathBuf) -> Self {
        KeptAudits { folder: Some(folder) }
    }

    /// The audit of a prepared imager: read from the folder, or made now and written there.
    ///
    /// # Errors
    /// Errors of [`audit`]. A folder that cannot be written is a warning.
    pub(crate) fn audit(
        &self,
        recipe: &Recipe,
        specimen: &dyn Specimen,
        imager: &dyn RegionImager,
        options: &AuditOptions,
        progress: &dyn Progress,
    ) -> Result<Audit> {
        let Some(folder) = &self.folder else {
            return audit(recipe, specimen, imager, options, progress);
        };
        let key = key(recipe, imager, options);
        let path = folder.join(format!("{}.{EXTENSION}", hex(&key)));
        match read(&path, &key) {
            Found::Whole(audit) => return Ok(*audit),
            Found::Missing => {}
            Found::Damaged => {
                progress.warn(&format!("{}: is damaged; audited again", path.display()));
            }
        }
        let made = audit(recipe, specimen, imager, options, progress)?;
        if let Err(why) = write(folder, &path, &key, &made) {
            progress.warn(&format!("the audit was not kept: {why}"));
        }
        Ok(made)
    }

    /// Removes all audits, and the folder if nothing else lies in it.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub(crate) fn clear(&self) -> Result<()> {
        let Some(folder) = self.folder.as_ref().filter(|f| f.is_dir()) else { return Ok(()) };
        let fail = |e| Error::io(folder, "read", e);
        for entry in fs::read_dir(folder).map_err(fail)? {
            let path = entry.map_err(fail)?.path();
            let own = path.extension().is_some_and(|e| e == EXTENSION);
            if own || atomic_write::is_leftover(&path) {
                fs::remove_file(&path).map_err(|e| Error::io(&path, "remove", e))?;
            }
        }
        // A folder that holds other files stays.
        let _ = fs::remove_dir(folder);
        Ok(())
    }
}

/// Everything that decides an audit, as text.
fn key(recipe: &Recipe, imager: &dyn RegionImager, options: &AuditOptions) -> String {
    let key = serde_json::json!({
        "numerics": NUMERICS_VERSION,
        "version": env!("CARGO_PKG_VERSION"),
        "recipe": recipe.to_toml(),
        "engine": imager.facts().name,
        "parameters": imager.facts().parameters,
        "audit": format!("{options:?}"),
    });
    key.to_string()
}

fn hex(text: &str) -> String {
    Sha256::digest(text).iter().map(|b| format!("{b:02x}")).collect()
}

enum Found {
    Whole(Box<Audit>),
    Missing,
    Damaged,
}

/// Reads an audit file. It has three lines: a digest of the two others, the key, and the audit.
fn read(path: &Path, key: &str) -> Found {
    let text = match fs::read_to_string(path) {
        Ok(text) => text,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Found::Missing,
        Err(_) => return Found::Damaged,
    };
    let whole = || {
        let (digest, rest) = text.split_once('\n')?;
        let audit = rest.strip_prefix(key)?.strip_prefix('\n')?;
        (digest == hex(rest)).then(|| serde_json::from_str(audit).ok())?
    };
    whole().map_or(Found::Damaged, |audit| Found::Whole(Box::new(audit)))
}

fn write(folder: &Path, path: &Path, key: &str, audit: &Audit) -> Result<()> {
    let Ok(text) = serde_json::to_string(audit) else { return Ok(()) };
    fs::create_dir_all(folder).map_err(|e| Error::io(folder, "create", e))?;
    let rest = format!("{key}\n{text}");
    atomic_write::write(path, format!("{}\n{rest}", hex(&rest)).as_bytes())
}
