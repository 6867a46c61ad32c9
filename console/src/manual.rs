//! `mrroc manual`: the manual pages and the completions of shells, from the definition of the command line itself.
//!
//! The package is made from what this writes, so neither can fall behind. `mrroc.1` goes on with the sections of
//! `manual.roff`, which no definition has.

use std::fs;
use std::io::{self, Write};
use std::path::Path;
use std::process::ExitCode;

use anyhow::Context;
use clap::Command;
use clap_complete::{Generator, Shell};
use clap_mangen::Man;

use crate::outputs::{Outputs, Replacement};

/// What shells are told of the command.
const SHELLS: [Shell; 3] = [Shell::Bash, Shell::Zsh, Shell::Fish];

/// Writes a page for every command that is not hidden, `mrroc-sdo-read.1` for `mrroc sdo read`, and the completions.
pub(crate) fn write(
    mut command: Command,
    directory: &Path,
    replacement: Replacement,
) -> anyhow::Result<ExitCode> {
    fs::create_dir_all(directory).with_context(|| directory.display().to_string())?;
    let mut outputs = Outputs::new(replacement);
    let mut files = Vec::new();
    let completions = SHELLS.map(|shell| {
        // Into memory first: what this writes to a file directly panics where the file takes nothing.
        let mut text = Vec::new();
        clap_complete::generate(shell, &mut command, "mrroc", &mut text);
        (shell.file_name("mrroc"), text)
    });
    let pages = pages(command).into_iter();
    let pages = pages.map(|(name, page)| (format!("{name}.1"), page));
    for (name, text) in completions.into_iter().chain(pages) {
        let path = directory.join(name);
        files.push((outputs.open("manual", &path)?, path, text));
    }
    outputs.begin()?;
    for (mut file, path, text) in files {
        let written = file.write_all(&text);
        written.with_context(|| format!("{} cannot be written", path.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The pages by name.
fn pages(command: Command) -> Vec<(String, Vec<u8>)> {
    let mut command = without_help(command);
    // Makes the full names of commands, which their usage begins with.
    command.build();
    let mut pages = Vec::new();
    let mut below = vec![command];
    while let Some(command) = below.pop() {
        below.extend(
            command
                .get_subcommands()
                .filter(|command| !command.is_hide_set())
                .cloned(),
        );
        let name = command
            .get_display_name()
            .unwrap_or(command.get_name())
            .to_owned();
        let mut page = Vec::new();
        render(command, &mut page).expect("a vector takes what is written");
        pages.push((name, page));
    }
    pages
}

/// `mrroc help run` is `man mrroc-run` in other words.
fn without_help(command: Command) -> Command {
    command
        .disable_help_subcommand(true)
        .mut_subcommands(without_help)
}

fn render(command: Command, page: &mut dyn Write) -> io::Result<()> {
    let top = command.get_name() == "mrroc";
    let (has_options, has_commands) = (
        command.get_arguments().any(|option| !option.is_hide_set()),
        command.has_subcommands(),
    );
    let man = Man::new(command).source(concat!("mrroc ", env!("CARGO_PKG_VERSION")));
    man.render_title(page)?;
    man.render_name_section(page)?;
    man.render_synopsis_section(page)?;
    man.render_description_section(page)?;
    if has_options {
        man.render_options_section(page)?;
    }
    if has_commands {
        man.render_subcommands_section(page)?;
    }
    page.write_all(match top {
        true => include_bytes!("manual.roff"),
        false => b".SH \"SEE ALSO\"\n.BR mrroc (1)\nhas the exit status, the files and examples.\n",
    })
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn every_command_has_a_page_that_shows_its_options() {
        let pages = pages(crate::Arguments::command());
        let names: Vec<_> = pages.iter().map(|(name, _)| &**name).collect();
        for name in ["mrroc", "mrroc-run", "mrroc-sdo-read", "mrroc-vm-qemu"] {
            assert!(names.contains(&name), "{names:?}");
        }
        for absent in ["help", "manual"] {
            assert!(!names.iter().any(|name| name.contains(absent)), "{names:?}");
        }
        let mut command = crate::Arguments::command();
        command.build();
        for (name, page) in pages {
            let page = String::from_utf8(page).unwrap();
            let of = name
                .split('-')
                .skip(1)
                .fold(&command, |of, word| of.find_subcommand(word).unwrap_or(of));
            for option in of.get_arguments().filter_map(clap::Arg::get_long) {
                let shown = format!("\\-\\-{}", option.replace('-', "\\-"));
                assert!(page.contains(&shown), "{name}: {shown}");
            }
        }
    }
}
