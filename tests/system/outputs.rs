//! Output files of commands: files that are never replaced, and files that `--force` replaces.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Command, Stdio};

use kit::mrroc::{Directory, Output, binary, example, mrroc, shorten};
use kit::refusals::refused;

use crate::configuration::{cell, dcf};

/// `mrroc` with `words`, followed by an option and its file.
fn with(words: &[&OsStr], option: &str, file: &Path) -> Output {
    let option = format!("--{option}={}", file.display());
    mrroc(words.iter().copied().chain([option.as_ref()]))
}

#[test]
fn no_output_replaces_the_cell_file_or_what_it_names() {
    let directory = Directory::new();
    let place = |name: &str| directory.path(name);
    let (dcf, _) = dcf(&[("6067", "ParameterValue=1234")]);
    let cell = cell(&directory, &dcf, |_| {});
    let words = fs::read_to_string(&cell).unwrap();
    fs::create_dir(place("sub")).unwrap();
    symlink(&cell, place("link")).unwrap();
    fs::hard_link(&cell, place("hard")).unwrap();
    let run = ["run".as_ref(), cell.as_os_str()];
    let others = [place("link"), place("hard"), place("sub/../cell.toml"), place("motor.dcf"), cell.clone()];
    for file in &others {
        for option in ["trace", "record", "spikes"] {
            refused(&with(&run, option, file), &[option]);
            let forced = [&run[..], &["--force".as_ref()]].concat();
            let needles = [option, "is the same file: name another"];
            refused(&with(&forced, option, file), &needles);
        }
    }
    let jitter = ["jitter", "--force", "--cell"].map(AsRef::as_ref);
    let jitter = [&jitter[..], &[cell.as_os_str()]].concat();
    refused(&with(&jitter, "spikes", &cell), &["the cell file is"]);
    // A measurement writes files with fixed names.
    fs::create_dir(place("out")).unwrap();
    symlink(&cell, place("out/bode.csv")).unwrap();
    let identify = ["identify", "--axis=column", "--force"].map(AsRef::as_ref);
    let identify = [&identify[..], &[cell.as_os_str()]].concat();
    refused(&with(&identify, "out", &place("out")), &["the cell file is"]);
    assert_eq!(fs::read_to_string(&cell).unwrap(), words);
    assert_eq!(fs::read_to_string(place("motor.dcf")).unwrap(), dcf);
    assert!(!place("out/bode.svg").exists());
}

#[test]
fn no_output_replaces_what_a_run_reads() {
    let directory = Directory::new();
    let place = |name: &str| directory.path(name);
    let cell = kit::teach::cell(&directory, "file = 'poses.trj'\nreplace = true");
    let files = [
        ("faults.toml", "[[fault]]\nat = 900.0\nkind = \"lost\"\naxis = \"column\"\n"),
        ("poses.trj", "JOINT\n1\nABSOLUTE\n1 1 1 1 1\n1 1 1 1 1\n0.3 -1.5 0 0 0\njoints = inclination\n"),
        ("orders", "record\ndone\n"),
    ];
    for (name, text) in files {
        directory.write(name, text);
        fs::hard_link(place(name), place(&format!("{name}.hard"))).unwrap();
        symlink(name, place(&format!("{name}.link"))).unwrap();
    }
    // A recording writes a candump log beside it.
    symlink("poses.trj", place("beside.log")).unwrap();
    let scenario = format!("--scenario={}", place("faults.toml").display());
    let tasks = [
        ("faults.toml", vec!["--task=home", &scenario], "the scenario is the same file"),
        ("poses.trj", vec!["--task=replay"], "a trajectory file of the task is the same file"),
        ("poses.trj", vec!["--task=teach", "--operator"], "the trajectory file of the task is the same file"),
        ("orders", vec!["--task=teach", "--operator"], "standard input is the same file"),
    ];
    for (file, task, refusal) in &tasks {
        let names = ["", ".hard", ".link"].map(|end| place(&format!("{file}{end}")));
        let options = ["trace", "record", "steps", "truth"];
        let mut outputs: Vec<_> = options.into_iter().flat_map(|it| names.iter().map(move |name| (it, name))).collect();
        let recording = place("beside.mcap");
        if *file == "poses.trj" {
            outputs.push(("record", &recording));
        }
        for (option, output) in outputs {
            let mut run = Command::new(binary());
            run.args(["run", "--bench=lockstep", "--force"]).args(task).arg(&cell);
            run.arg(format!("--{option}={}", output.display()));
            let run = run.stdin(File::open(place("orders")).unwrap()).output().unwrap();
            let said = String::from_utf8(run.stderr).unwrap();
            assert_eq!(run.status.code(), Some(2), "{task:?}, --{option} {output:?}: {said}");
            assert!(said.contains(refusal), "{task:?}, --{option} {output:?}: {said}");
            for (name, text) in files {
                assert_eq!(fs::read_to_string(place(name)).unwrap(), text, "{task:?}, --{option} {output:?}");
            }
        }
    }
}

#[test]
fn two_runs_never_write_into_one_file() {
    let directory = Directory::new();
    let cell = directory.cell("irb6", shorten);
    let record = directory.write("axes.csv", "of another run");
    let other = File::options().append(true).open(&record).unwrap();
    other.lock().unwrap();
    let words = ["run", "--bench=lockstep", "--force"].map(AsRef::as_ref);
    let words = [&words[..], &[cell.as_os_str()]].concat();
    refused(&with(&words, "record", &record), &["--record", "another command writes to the file"]);
    assert_eq!(fs::read_to_string(&record).unwrap(), "of another run");
    drop(other);
    let run = with(&words, "record", &record);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    assert!(fs::read_to_string(record).unwrap().starts_with("cycle,"));
}

#[test]
fn two_outputs_are_never_one_file() {
    let directory = Directory::new();
    let place = |name: &str| directory.path(name);
    symlink(".", place("here")).unwrap();
    symlink("a", place("link")).unwrap();
    let cell = example("irb6");
    let pairs = [("a", "a"), ("a", "here/a"), ("link", "a"), ("a", "link")];
    for (one, other) in pairs {
        let trace = format!("--trace={}", place(one).display());
        let words = ["run", "--bench=lockstep", "--force", &trace].map(AsRef::as_ref);
        let words = [&words[..], &[cell.as_os_str()]].concat();
        let run = with(&words, "record", &place(other));
        refused(&run, &["--record", "--trace has the same file"]);
        assert!(!place("a").exists(), "{one} {other}");
    }
    // Outputs to a device do not collide. Outputs to the file that standard output is redirected to do.
    let both = ["run", "--bench=lockstep", "--trace=/dev/null"].map(AsRef::as_ref);
    let both = [&both[..], &[cell.as_os_str()]].concat();
    let run = with(&both, "record", Path::new("/dev/null"));
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let run = Command::new(binary())
        .args(&both)
        .arg("--record=/dev/stdout")
        .stdout(File::create(place("report")).unwrap())
        .stderr(Stdio::piped())
        .output()
        .unwrap();
    assert_eq!(run.status.code(), Some(2), "{run:?}");
    let said = String::from_utf8(run.stderr).unwrap();
    assert!(said.contains("standard output is the same file"), "{said}");
    let piped = with(&both, "record", Path::new("/dev/stdout"));
    assert_eq!(piped.status.code(), Some(0), "{piped:?}");
    assert!(piped.stdout.starts_with("cycle,time_s,axis,"), "{}", &piped.stdout[..100]);
    assert!(piped.stdout.contains("completed"));
}

#[test]
fn what_is_there_is_replaced_by_force_alone() {
    let directory = Directory::new();
    let place = |name: &str| directory.path(name);
    let cell = directory.cell("irb6", shorten);
    let old = "old\n".repeat(1 << 20);
    let run = ["run", "--bench=lockstep"].map(AsRef::as_ref);
    let run = [&run[..], &[cell.as_os_str()]].concat();
    let measure = ["identify", "--axis=column"].map(AsRef::as_ref);
    let measure = [&measure[..], &[cell.as_os_str()]].concat();
    let jitter: Vec<&OsStr> = ["jitter", "--duration=1s"].map(AsRef::as_ref).to_vec();
    for (words, option, file, begins) in [
        (&run, "trace", "trace.log", "(0"),
        (&run, "record", "states.csv", "cycle,"),
        (&run, "out", "report.html", "<!DOCTYPE html>"),
        (&jitter, "spikes", "spikes.json", "{"),
        (&jitter, "out", "ours.hgrm", "    "),
        (&jitter, "out", "jitter.svg", "<svg"),
        (&measure, "out", "bode.csv", "frequency_hz,"),
        (&measure, "out", "bode.svg", "<svg"),
    ] {
        fs::write(place(file), &old).unwrap();
        let given = if option == "out" { place(".") } else { place(file) };
        let again = with(words, option, &given);
        refused(&again, &[option, file, "--force"]);
        assert_eq!(fs::read_to_string(place(file)).unwrap(), old, "{file}");
        let forced = [&words[..], &["--force".as_ref()]].concat();
        let forced = with(&forced, option, &given);
        assert_eq!(forced.status.code(), Some(0), "{forced:?}");
        let written = fs::read_to_string(place(file)).unwrap();
        assert!(written.starts_with(begins), "{file}: {}", &written[..100]);
        assert!(!written.contains("old\n"), "{file}");
        for name in fs::read_dir(place(".")).unwrap() {
            let path = name.unwrap().path();
            if path != cell {
                fs::remove_file(path).unwrap();
            }
        }
    }
}

#[test]
fn a_refused_run_leaves_no_file_behind_and_empties_none() {
    let directory = Directory::new();
    let [new, old] = ["new.log", "old.csv"].map(|name| directory.path(name));
    fs::write(&old, "precious").unwrap();
    let cell = example("irb6");
    let trace = format!("--trace={}", new.display());
    let words = ["run", "--bench=vcan", "--can=nosuch0", "--force", &trace].map(AsRef::as_ref);
    let words = [&words[..], &[cell.as_os_str()]].concat();
    refused(&with(&words, "record", &old), &["nosuch0"]);
    assert!(!new.exists());
    assert_eq!(fs::read_to_string(&old).unwrap(), "precious");
}

#[test]
fn manual_pages_that_do_not_fit_are_refused_by_name() {
    let directory = Directory::new();
    let pages = directory.path("pages");
    let limited = |limit: &str| {
        let script = format!("ulimit -f {limit}; exec \"$@\"");
        let command = Command::new("sh")
            .args(["-c", &script, "sh"])
            .arg(binary())
            .args(["manual", "--force"])
            .arg(&pages)
            .output();
        command.unwrap()
    };
    let run = limited("0");
    assert_eq!(run.status.code(), Some(2), "{run:?}");
    let said = String::from_utf8(run.stderr).unwrap();
    assert_eq!(said.lines().count(), 1, "{said}");
    let name = pages.join("mrroc.bash");
    assert!(said.contains(name.to_str().unwrap()) && said.contains("File too large"), "{said}");
    assert_eq!(limited("unlimited").status.code(), Some(0));
    assert!(fs::metadata(pages.join("mrroc-run.1")).unwrap().len() > 1000);
    let again = mrroc(["manual".as_ref(), pages.as_os_str()]);
    refused(&again, &["mrroc.bash", "--force"]);
}

#[test]
fn a_report_that_nobody_reads_is_an_error_of_the_run() {
    let directory = Directory::new();
    let cell = directory.cell("irb6", shorten);
    let mut run = Command::new(binary())
        .arg("run")
        .arg(cell)
        .args(["--bench", "lockstep"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(run.stdout.take());
    let ended = run.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(1), "{said}");
    assert!(
        said.contains("the report cannot be printed: standard output is closed. The run ended: completed"),
        "{said}"
    );
}
