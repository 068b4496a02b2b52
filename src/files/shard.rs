//! The part of one of several processes that share a piece of work.

use std::str::FromStr;

use crate::error::{Error, Result};
use crate::setting::Setting;

/// Process `index`, counted from 0, of `count`. Its part of a list depends on nothing else.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    count: usize,
}

impl Shard {
    /// The only process.
    pub const WHOLE: Shard = Shard { index: 0, count: 1 };

    /// Returns process `index` of `count`.
    ///
    /// # Errors
    /// [`Error::Invalid`] unless `index` is below `count`.
    pub fn new(index: usize, count: usize) -> Result<Self> {
        if index < count {
            return Ok(Shard { index, count });
        }
        let expected = match count {
            0 => "a number of shards above 0".into(),
            n => format!("shards are counted from 0; expected 0/{n} to {}/{n}", n - 1),
        };
        Err(Error::invalid(Setting::Shard, format!("{index}/{count}"), expected))
    }

    /// Returns the part of a task of a Slurm job array, whose tasks may have any numbers with equal steps; `variable` returns an
    /// environment variable.
    ///
    /// # Errors
    /// [`Error::Invalid`] if the variables are missing.
    pub fn of_slurm(variable: impl Fn(&str) -> Option<String>) -> Result<Self> {
        let number = |name: &str| -> Result<usize> {
            let value = variable(name);
            let parsed = value.as_deref().and_then(|v| v.trim().parse().ok());
            parsed.ok_or_else(|| {
                let found = value.unwrap_or_else(|| "nothing".into());
                let expected = "a number: this is for the tasks of a Slurm job array";
                Error::invalid(Setting::Shard, format!("{name} = {found}"), expected)
            })
        };
        let [task, first] = [number("SLURM_ARRAY_TASK_ID")?, number("SLURM_ARRAY_TASK_MIN")?];
        let step = match variable("SLURM_ARRAY_TASK_STEP") {
            Some(_) => number("SLURM_ARRAY_TASK_STEP")?.max(1),
            None => 1,
        };
        Shard::new(task.saturating_sub(first) / step, number("SLURM_ARRAY_TASK_COUNT")?)
    }

    /// Returns the number of the process, from 0.
    pub fn index(self) -> usize {
        self.index
    }

    /// Returns the number of processes.
    pub fn count(self) -> usize {
        self.count
    }

    /// Whether the process does the item with this number.
    pub(crate) fn does(self, thing: usize) -> bool {
        thing % self.count == self.index
    }
}

impl FromStr for Shard {
    type Err = Error;

    /// Reads `0/16`, the first of sixteen.
    fn from_str(text: &str) -> Result<Self> {
        let parsed = text.split_once('/').and_then(|(index, count)| {
            Some((index.trim().parse().ok()?, count.trim().parse().ok()?))
        });
        let Some((index, count)) = parsed else {
            let expected = "K/N, such as 0/16 to 15/16 for sixteen shards";
            return Err(Error::invalid(Setting::Shard, text, expected));
        };
        Shard::new(index, count)
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_do_everything_once() {
        for count in [1, 3, 7] {
            let all: Vec<Shard> = (0..count).map(|k| Shard::new(k, count).unwrap()).collect();
            for thing in 0..20 {
                assert_eq!(all.iter().filter(|s| s.does(thing)).count(), 1);
            }
        }
    }

    #[test]
    fn bad_shards_are_refused() {
        assert_eq!("2/3".parse::<Shard>().unwrap(), Shard::new(2, 3).unwrap());
        for bad in ["3/3", "0/0", "-1/2", "1", "a/b", "1/2/3", ""] {
            assert!(bad.parse::<Shard>().is_err(), "{bad}");
        }
        let message = "3/3".parse::<Shard>().unwrap_err().to_string();
        assert!(message.contains("0/3 to 2/3"), "{message}");
    }

    #[test]
    fn tasks_of_slurm_may_have_any_numbers() {
        let array = |task: &'static str, first: &'static str, step: Option<&'static str>| {
            Shard::of_slurm(move |name| match name {
                "SLURM_ARRAY_TASK_ID" => Some(task.into()),
                "SLURM_ARRAY_TASK_MIN" => Some(first.into()),
                "SLURM_ARRAY_TASK_COUNT" => Some("4".into()),
                "SLURM_ARRAY_TASK_STEP" => step.map(Into::into),
                _ => None,
            })
        };
        assert_eq!(array("3", "0", None).unwrap(), Shard::new(3, 4).unwrap());
        assert_eq!(array("16", "10", Some("2")).unwrap(), Shard::new(3, 4).unwrap());
        assert!(array("18", "10", Some("2")).is_err());
        let message = Shard::of_slurm(|_| None).unwrap_err().to_string();
        assert!(
            message.contains("SLURM_ARRAY_TASK_ID") && message.contains("job array"),
            "{message}"
        );
    }
}
