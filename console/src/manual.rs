//! `mrroc manual`: manual pages and shell completions, generated from the definition of the command line.
//!
//! The package is built from the output of this command, so pages and completions always match the program. `mrroc.1`
//! also contains the sections of `manual.roff`, which have no counterpart in the definition.

use std::fs;
use std::io::{self, Write};
use std::path::Path;
use std::process::ExitCode;

use anyhow::Context;
use clap::Command;
use clap_complete::{Generator, Shell};
use clap_mangen::Man;

use mrroc::outputs::{Outputs, Replacement};

const SHELLS: [Shell; 3] = [Shell::Bash, Shell::Zsh, Shell::Fish];

/// Writes the completions, and a page for every command that is not hidden, such as `mrroc-sdo-read.1` for `mrroc sdo
/// read`.
pub(crate) fn write(mut command: Command, directory: &Path, replacement: Replacement) -> anyhow::Result<ExitCode> {
    fs::create_dir_all(directory).with_context(|| directory.display().to_string())?;
    let mut outputs = Outputs::new(replacement);
    let mut files = Vec::new();
    let completions = SHELLS.map(|shell| {
        // The text is generated in memory, because the generator panics if a write to a file fails.
        let mut text = Vec::new();
        clap_complete::generate(shell, &mut command, "mrroc", &mut text);
        (shell.file_name("mrroc"), text)
    });
    let pages = pages(command).into_iter().map(|(name, page)| (format!("{name}.1"), page));
    for (name, text) in completions.into_iter().chain(pages) {
        let path = directory.join(name);
        files.push((outputs.open("manual", &path)?, path, text));
    }
    outputs.begin()?;
    for (mut file, path, text) in files {
        file.write_all(&text).with_context(|| format!("{} cannot be written", path.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn pages(command: Command) -> Vec<(String, Vec<u8>)> {
    let mut command = without_help(command);
    // Builds the full names of the commands, with which their usage texts begin.
    command.build();
    let mut pages = Vec::new();
    let mut below = vec![command];
    while let Some(command) = below.pop() {
        below.extend(command.get_subcommands().filter(|it| !it.is_hide_set()).cloned());
        let name = command.get_display_name().unwrap_or(command.get_name()).to_owned();
        let mut page = Vec::new();
        render(command, &mut page).expect("a vector takes what is written");
        pages.push((name, page));
    }
    pages
}

/// Removes the `help` commands: `mrroc help run` shows the same text as `man mrroc-run`.
fn without_help(command: Command) -> Command {
    command.disable_help_subcommand(true).mut_subcommands(without_help)
}

fn render(command: Command, page: &mut dyn Write) -> io::Result<()> {
    let top = command.get_name() == "mrroc";
    let has_options = command.get_arguments().any(|it| !it.is_hide_set());
    let has_commands = command.has_subcommands();
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
            let of = name.split('-').skip(1).fold(&command, |of, word| of.find_subcommand(word).unwrap_or(of));
            for option in of.get_arguments().filter_map(clap::Arg::get_long) {
                let shown = format!("\\-\\-{}", option.replace('-', "\\-"));
                assert!(page.contains(&shown), "{name}: {shown}");
            }
        }
    }
}
