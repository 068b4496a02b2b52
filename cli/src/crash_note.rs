//! Message of a program that dies while it reads a file of another program.
//!
//! A few damaged files make the HDF5 library (1.10.8) read or write beyond its own memory. Whether this ends the process depends on
//! the contents of that memory. So a file may pass the process that reads it first ([`super::hdf5_check`]), and end the process that
//! reads it next. The second process then prints the name of the file, and ends with the exit code of an error.

use std::ffi::CString;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicPtr, Ordering};

/// The message; null until a file is named.
static WORDS: AtomicPtr<CString> = AtomicPtr::new(std::ptr::null_mut());
/// The files that the message names.
static FILES: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// Has the program print that `file` is damaged if it dies from now on.
pub fn name(file: &Path) {
    let Ok(mut files) = FILES.lock() else { return };
    files.push(format!("{}", file.display()));
    let words = format!(
        "error: {}: is damaged: the HDF5 library died of it; copy or build it again\n",
        files.join(" or ")
    );
    let Ok(words) = CString::new(words) else { return };
    // The message is never freed, since a handler may read it at any time.
    WORDS.store(Box::leak(Box::new(words)), Ordering::Release);
    #[cfg(unix)]
    if files.len() == 1 {
        unix::listen();
    }
}

#[cfg(unix)]
mod unix {
    use crate::crash_note::WORDS;
    use std::sync::atomic::Ordering;

    /// Signals that end a process after a read or write in wrong memory.
    const DEADLY: [i32; 5] =
        [libc::SIGSEGV, libc::SIGBUS, libc::SIGABRT, libc::SIGFPE, libc::SIGILL];

    pub fn listen() {
        // SAFETY: the handler calls nothing but `write` and `_exit`, which handlers may call. It runs on the stack that each thread
        // has for handlers, since its own may be full. All zeros are a valid action, with no flags and an empty mask.
        unsafe {
            let mut action: libc::sigaction = std::mem::zeroed();
            action.sa_sigaction = speak as extern "C" fn(i32) as libc::sighandler_t;
            action.sa_flags = libc::SA_ONSTACK | libc::SA_RESETHAND;
            for signal in DEADLY {
                libc::sigaction(signal, &raw const action, std::ptr::null_mut());
            }
        }
    }

    extern "C" fn speak(_: i32) {
        // SAFETY: the message was leaked, so it is valid for ever. `listen` explains why the two calls are allowed here.
        unsafe {
            if let Some(words) = WORDS.load(Ordering::Acquire).as_ref() {
                let bytes = words.as_bytes();
                libc::write(libc::STDERR_FILENO, bytes.as_ptr().cast(), bytes.len());
            }
            libc::_exit(1);
        }
    }
}
