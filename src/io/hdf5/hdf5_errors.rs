//! Errors of HDF5, with the file that they concern.

use std::path::Path;

use crate::error::{Error, Result};

/// Names the file in an error of HDF5.
pub(crate) trait At<T> {
    fn at(self, path: &Path) -> Result<T>;
}

impl<T> At<T> for hdf5::Result<T> {
    fn at(self, path: &Path) -> Result<T> {
        self.map_err(|e| match os_error(&e.to_string()) {
            Some(source) => Error::io(path, "read or write", source),
            None => Error::hdf5(path, e),
        })
    }
}

/// Returns the operating system's error (a full disk ...), which HDF5 includes in its text.
fn os_error(text: &str) -> Option<std::io::Error> {
    let number = text.split("errno = ").nth(1)?.split(|c: char| !c.is_ascii_digit()).next()?;
    number.parse().ok().map(std::io::Error::from_raw_os_error)
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_reason_of_the_system_is_found() {
        let text = "H5Dwrite(): can't write data: file write failed: filename = 'w.h5', file \
                    descriptor = 3, errno = 28, error message = 'No space left on device'";
        let found = super::os_error(text).unwrap();
        assert_eq!(found.kind(), std::io::ErrorKind::StorageFull);
        assert!(super::os_error("can't open file").is_none());
    }
}
