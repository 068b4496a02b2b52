//! What strangers' files say never reaches a terminal, a shell or a page as code.

use super::dm_bytes::{DM4, document, floats, image};
use super::{fails, file, stderr, stdout, stemgen};
use hdf5::types::VarLenUnicode;
use std::path::Path;
use std::process::{Command, Output};

/// Clears a terminal, names its window, turns the order of letters, adds lines, and is markup.
const HOSTILE: &str = "a\u{1b}[2J\u{1b}]0;b\u{7}\u{9b}1m\u{202e}c\r\n# d\n<script>e()</script> `f` | [g](h) &lt; \u{2028}i";

/// What is shown holds nothing that a terminal obeys.
#[track_caller]
fn only_shows(output: &Output, what: &str) {
    for text in [stdout(output), stderr(output)] {
        let obeyed = text
            .chars()
            .find(|c| (c.is_control() && *c != '\n') || ('\u{2028}'..='\u{202e}').contains(c));
        assert_eq!(obeyed, None, "{what}: {text:?}");
        assert!(
            !text.contains("\n# d"),
            "{what}: a text of the file has a line of its own: {text}"
        );
        assert!(!text.contains("panicked"), "{what}: {text}");
    }
}

/// Puts the hostile text in an attribute of a world.
fn spoil(world: &Path, name: &str) {
    let file = hdf5::File::open_rw(world).unwrap();
    let about = file.group("metadata").unwrap();
    let text: VarLenUnicode = HOSTILE.parse().unwrap();
    about.delete_attr(name).unwrap();
    about.new_attr::<VarLenUnicode>().create(name).unwrap().write_scalar(&text).unwrap();
    file.close().unwrap();
}

/// Names of the attributes of a world that are texts.
fn texts(world: &Path) -> Vec<String> {
    let file = hdf5::File::open(world).unwrap();
    let about = file.group("metadata").unwrap();
    let is_text = |name: &String| {
        let attribute = about.attr(name).unwrap();
        attribute.is_scalar() && attribute.read_scalar::<VarLenUnicode>().is_ok()
    };
    about.attr_names().unwrap().into_iter().filter(is_text).collect()
}

#[test]
fn attributes_of_a_world_are_shown_and_do_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let tiny = file("tests/cli/tiny.toml");
    let mut build = stemgen(here);
    build.args(["build", "--recipe", &tiny, "--audit", "0", "--no-png", "-o", "whole.h5"]);
    assert!(build.output().unwrap().status.success());
    let names = texts(&here.join("whole.h5"));
    assert!(names.len() > 4 && names.iter().any(|name| name == "recipe"), "{names:?}");
    let mut shown = 0;
    for name in names {
        std::fs::copy(here.join("whole.h5"), here.join("w.h5")).unwrap();
        spoil(&here.join("w.h5"), &name);
        for arguments in [&["info", "w.h5"][..], &["info", "w.h5", "--json"], &["verify", "w.h5"]] {
            let output = stemgen(here).args(arguments).output().unwrap();
            only_shows(&output, &format!("{name}: {arguments:?}"));
            let printed = stdout(&output);
            shown += usize::from(printed.contains("\\u001b[2J"));
        }
        let out = format!("card of {name}");
        let card = stemgen(here)
            .args(["card", "w.h5", "-o", &out, "--title", "A world"])
            .output()
            .unwrap();
        only_shows(&card, &name);
        let Ok(page) = std::fs::read_to_string(here.join(&out).join("README.md")) else { continue };
        assert!(!page.chars().any(|c| (c.is_control() && c != '\n') || c == '\u{202e}'), "{name}");
        // Outside of blocks of code.
        let prose: String = page.split("```").step_by(2).collect();
        for markup in ["<script>", "\n# d", "[g](h)"] {
            assert!(!prose.contains(markup), "{name}: `{markup}` in\n{prose}");
        }
    }
    assert!(shown > 2, "hardly any text of a world is shown: {shown}");
}

#[test]
fn names_in_recorded_files_are_shown_and_do_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let pixels = || floats(DM4, (0..130 * 130).map(|k| (k % 97) as f32));
    let one = |name: &'static str| image(name, &[130, 130], 2, 6, pixels(), (0.02, "nm"));
    std::fs::write(here.join("one.dm4"), DM4.file(document(vec![one(HOSTILE)]))).unwrap();
    let both = document(vec![one(HOSTILE), one("plain")]);
    std::fs::write(here.join("two.dm4"), DM4.file(both)).unwrap();
    let run = |arguments: &[&str]| stemgen(here).args(arguments).output().unwrap();
    let imported = run(&["import", "one.dm4", "-o", "w.h5"]);
    assert!(imported.status.success(), "{}", stderr(&imported));
    only_shows(&imported, "import");
    assert!(stdout(&imported).contains("a\\u001b[2J"), "{}", stdout(&imported));
    only_shows(&run(&["import", "one.dm4", "-o", "v.h5", "--json"]), "import --json");
    only_shows(&run(&["info", "w.h5"]), "info");
    // The list of images in an error may have several lines.
    let printed = stderr(&run(&["import", "two.dm4", "-o", "u.h5"]));
    assert!(
        printed.contains("plain") && !printed.contains('\u{1b}') && !printed.contains('\u{202e}'),
        "{printed}"
    );
    let page = run(&["view", "w.h5", "--html", "-o", "w.html", "--quiet"]);
    assert!(page.status.success(), "{}", stderr(&page));
    let page = std::fs::read_to_string(here.join("w.html")).unwrap();
    assert!(!page.contains("<script>e()"), "a name of the file is code of the page");
}

/// A name of a file with ends of lines, in a script that is run.
#[test]
fn no_name_of_an_output_runs_in_the_script_of_a_cluster() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let script = |name: &str| {
        let mut slurm = stemgen(here);
        slurm.args(["slurm", "--shards", "2", "build", "--recipe", &file("tests/cli/tiny.toml")]);
        slurm.args(["-o", name]);
        slurm
    };
    for name in
        ["a\ntouch ran\n.h5", "a\r\ntouch ran #.h5", "a\u{1b}[2J.h5", "a\u{2028}touch ran.h5"]
    {
        let printed = fails(&mut script(name));
        assert!(printed.contains("no place in a script"), "{printed}");
        only_shows(&script(name).output().unwrap(), name);
    }
    for name in ["a$(touch ran)`touch ran`\";touch ran;\".h5", "a' ; touch ran ; '.h5"] {
        let output = script(name).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        std::fs::write(here.join("job.sh"), stdout(&output)).unwrap();
        // A cluster that only takes jobs, and runs what each is to run in a shell, with a program that does nothing.
        let bin = here.join("bin");
        std::fs::create_dir_all(&bin).unwrap();
        let sbatch = "#!/bin/bash\nwhile [ $# -gt 1 ]; do shift; done\nbash -c \"$1\"\necho 1\n";
        for (program, text) in [("sbatch", sbatch), ("nothing", "#!/bin/bash\nexit 0\n")] {
            use std::os::unix::fs::PermissionsExt;
            std::fs::write(bin.join(program), text).unwrap();
            let rights = std::fs::Permissions::from_mode(0o755);
            std::fs::set_permissions(bin.join(program), rights).unwrap();
        }
        let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap());
        let mut bash = Command::new("bash");
        bash.arg("job.sh").current_dir(here).env("PATH", path).env("STEMGEN", bin.join("nothing"));
        let ran = bash.output().unwrap();
        assert!(ran.status.success(), "{name:?}: {}", stderr(&ran));
        assert!(!here.join("ran").exists(), "{name:?} ran as a command:\n{}", stdout(&output));
        assert!(stdout(&ran).contains("writes a"), "{}", stdout(&ran));
    }
}
