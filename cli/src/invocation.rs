//! How the program was called: two programs have this command line, `stemgen` and, of the Python package, `stemworlds`.

use std::borrow::Cow;
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::OnceLock;

/// The name in help texts and messages as they are written.
const WRITTEN: &str = "stemgen";

/// How the program was called.
#[derive(Debug, Clone)]
pub struct Invocation {
    /// Name of the program, for messages.
    pub name: &'static str,
    /// What was typed behind it.
    pub arguments: Vec<OsString>,
    /// Program and first arguments that start it once more; this program by itself when empty.
    pub again: Vec<OsString>,
}

static CALLED: OnceLock<Invocation> = OnceLock::new();

impl Invocation {
    /// `stemgen` with the arguments of this process.
    pub fn of_process() -> Self {
        let arguments = std::env::args_os().skip(1).collect();
        Invocation { name: WRITTEN, arguments, again: Vec::new() }
    }

    /// Makes it the one of this process, if there was none before.
    pub fn remember(self) -> &'static Self {
        CALLED.get_or_init(|| self)
    }

    /// The one of this process.
    pub fn now() -> &'static Self {
        CALLED.get_or_init(Self::of_process)
    }

    /// Program and first arguments that start it once more.
    ///
    /// # Errors
    /// Those of the system.
    pub fn again(&self) -> std::io::Result<Vec<OsString>> {
        if !self.again.is_empty() {
            return Ok(self.again.clone());
        }
        // Also where the file of the program was replaced meanwhile.
        let program = match cfg!(target_os = "linux") {
            true => PathBuf::from("/proc/self/exe"),
            false => std::env::current_exe()?,
        };
        Ok(vec![program.into_os_string()])
    }

    /// A text with the name of the program that was called in place of the written one.
    pub fn named<'t>(&self, text: &'t str) -> Cow<'t, str> {
        if self.name == WRITTEN {
            return Cow::Borrowed(text);
        }
        // Commands only: `stemgen build`, not `stemgen/` or `stemgen 1.0`.
        let (mut out, mut rest) = (String::new(), text);
        while let Some(at) = rest.find(WRITTEN) {
            let (before, after) = (&rest[..at], &rest[at + WRITTEN.len()..]);
            let begins = !before.ends_with(|c: char| c.is_alphanumeric() || "/_-.".contains(c));
            let command = |c: char| c.is_ascii_lowercase() || c == 'C';
            let follows = after.strip_prefix(' ').is_some_and(|next| next.starts_with(command));
            out += before;
            out += if begins && follows { self.name } else { WRITTEN };
            rest = after;
        }
        Cow::Owned(out + rest)
    }

    /// A definition of options with the same change in all of its texts.
    pub fn named_in(&self, command: clap::Command) -> clap::Command {
        if self.name == WRITTEN {
            return command;
        }
        let text = |styled: &clap::builder::StyledStr| self.named(&styled.to_string()).into_owned();
        let about = command.get_about().map(text);
        let long_about = command.get_long_about().map(text);
        let after = command.get_after_help().map(text);
        let mut command = command.mut_args(|arg| {
            let (help, long) = (arg.get_help().map(text), arg.get_long_help().map(text));
            let arg = help.map_or(arg.clone(), |help| arg.help(help));
            long.map_or(arg.clone(), |long| arg.long_help(long))
        });
        command = about.map_or(command.clone(), |about| command.about(about));
        command = long_about.map_or(command.clone(), |about| command.long_about(about));
        command = after.map_or(command.clone(), |after| command.after_help(after));
        command.mut_subcommands(|inner| self.named_in(inner))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_have_the_name_that_was_called() {
        let called = Invocation { name: "stemworlds", ..Invocation::of_process() };
        let named =
            called.named("`stemgen build` by stemgen 1.0; stemgen/ of ~/.cache, stemgen-x y");
        assert_eq!(named, "`stemworlds build` by stemgen 1.0; stemgen/ of ~/.cache, stemgen-x y");
        assert_eq!(called.named("`stemgen COMMAND --help`"), "`stemworlds COMMAND --help`");
        assert_eq!(Invocation::of_process().named("stemgen list"), "stemgen list");
    }
}
