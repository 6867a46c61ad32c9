//! Questions of `mrroc new` for missing arguments, and places of descriptions in packages.

use std::io::{BufRead, IsTerminal as _, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail, ensure};

use super::Options;

/// Prefix of the name of a file in a package of ROS.
const IN_A_PACKAGE: &str = "package://";

/// A package of ROS and its folder.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Package {
    name: String,
    folder: PathBuf,
}

impl std::str::FromStr for Package {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once('=') {
            Some((name, folder)) if !(name.is_empty() || folder.is_empty() || name.contains('/')) => {
                Ok(Self { name: name.to_owned(), folder: folder.into() })
            }
            _ => Err("must be NAME=DIR, the name of a package and its folder".to_owned()),
        }
    }
}

/// The cell file to write, and the description of its robot.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Order {
    pub(super) cell: PathBuf,
    pub(super) urdf: PathBuf,
    pub(super) base: Option<String>,
    pub(super) flange: Option<String>,
}

impl Order {
    /// The order from the arguments and, on a terminal, from the answers of the user.
    pub(super) fn of(options: &Options) -> anyhow::Result<Self> {
        let stdin = std::io::stdin();
        let is_whole = options.cell.is_some() && options.urdf.is_some();
        ensure!(
            is_whole || stdin.is_terminal(),
            "CELL and --urdf FILE are needed: without them `mrroc new` asks, and standard input is no terminal"
        );
        Self::asked(options, &mut stdin.lock(), &mut std::io::stderr())
    }

    /// Asks for missing arguments. If the arguments name both files, no question is asked.
    fn asked(options: &Options, answers: &mut dyn BufRead, questions: &mut dyn Write) -> anyhow::Result<Self> {
        let is_whole = options.cell.is_some() && options.urdf.is_some();
        let mut ask = |question: &str, usual: Option<&str>| -> anyhow::Result<Option<String>> {
            match usual {
                Some(usual) => write!(questions, "{question} [{usual}]: "),
                None => write!(questions, "{question}: "),
            }?;
            questions.flush()?;
            let mut line = String::new();
            ensure!(answers.read_line(&mut line)? > 0, "{question}: standard input has ended");
            Ok(Some(line.trim().to_owned()).filter(|answer| !answer.is_empty()))
        };
        let urdf = match &options.urdf {
            Some(urdf) => urdf.clone(),
            None => ask("Robot description in URDF", None)?.context("no description was named")?.into(),
        };
        let urdf = in_its_package(&urdf, &options.package)?;
        let cell = match &options.cell {
            Some(cell) => cell.clone(),
            None => {
                let stem = urdf.file_stem().and_then(|stem| stem.to_str()).unwrap_or("arm");
                let usual = format!("{stem}.toml");
                ask("Cell file to write", Some(&usual))?.unwrap_or(usual).into()
            }
        };
        let mut link = |given: &Option<String>, question: &str, usual: &str| match given {
            None if !is_whole => ask(question, Some(usual)),
            given => Ok(given.clone()),
        };
        let base = link(&options.base, "Base link", "the root of the description")?;
        let flange = link(&options.flange, "Flange link", "the only end of the description")?;
        Ok(Self { cell, urdf, base, flange })
    }
}

/// The file of a description that may lie in a package.
fn in_its_package(urdf: &Path, packages: &[Package]) -> anyhow::Result<PathBuf> {
    let Some(place) = urdf.to_str().and_then(|text| text.strip_prefix(IN_A_PACKAGE)) else {
        return Ok(urdf.to_owned());
    };
    let Some((name, file)) = place.split_once('/') else {
        bail!("--urdf {}: must be package://NAME/FILE", urdf.display());
    };
    match packages.iter().find(|package| package.name == name) {
        Some(package) => Ok(package.folder.join(file)),
        None => bail!("--urdf {}: the folder of the package is not known, add --package {name}=DIR", urdf.display()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(cell: Option<&str>, urdf: Option<&str>, packages: &[&str]) -> Options {
        Options {
            cell: cell.map(PathBuf::from),
            urdf: urdf.map(PathBuf::from),
            package: packages.iter().map(|text| text.parse().unwrap()).collect(),
            base: None,
            flange: Some("tool".to_owned()).filter(|_| cell.is_some()),
        }
    }

    fn asked(options: &Options, answers: &str) -> (Result<Order, String>, String) {
        let mut questions = Vec::new();
        let order = Order::asked(options, &mut answers.as_bytes(), &mut questions);
        (order.map_err(|error| error.to_string()), String::from_utf8(questions).unwrap())
    }

    #[test]
    fn what_the_arguments_leave_open_is_asked() {
        let order = |cell: &str, urdf: &str, base: Option<&str>, flange: Option<&str>| Order {
            cell: cell.into(),
            urdf: urdf.into(),
            base: base.map(str::to_owned),
            flange: flange.map(str::to_owned),
        };
        let (found, questions) = asked(&options(None, None, &[]), "arms/puma.urdf\n\n link0 \ntool\n");
        assert_eq!(found, Ok(order("puma.toml", "arms/puma.urdf", Some("link0"), Some("tool"))));
        assert_eq!(
            questions,
            "Robot description in URDF: Cell file to write [puma.toml]: Base link [the root of the description]: \
             Flange link [the only end of the description]: "
        );
        let (found, questions) = asked(&options(Some("a.toml"), None, &[]), "b.urdf\n\n");
        assert_eq!(found, Ok(order("a.toml", "b.urdf", None, Some("tool"))));
        assert_eq!(questions, "Robot description in URDF: Base link [the root of the description]: ");
        let (found, questions) = asked(&options(Some("a.toml"), Some("b.urdf"), &[]), "");
        assert_eq!((found, questions.as_str()), (Ok(order("a.toml", "b.urdf", None, Some("tool"))), ""));
    }

    #[test]
    fn answers_that_are_missing_are_named() {
        assert_eq!(asked(&options(None, None, &[]), "\n").0, Err("no description was named".to_owned()));
        let ended = asked(&options(None, None, &[]), "b.urdf\n").0.unwrap_err();
        assert_eq!(ended, "Cell file to write: standard input has ended");
    }

    #[test]
    fn a_description_in_a_package_is_found_in_its_folder() {
        let packages = ["ur_description=/opt/ur", "other=relative/folder"];
        let at = |urdf: &str| {
            let (order, _) = asked(&options(Some("a.toml"), Some(urdf), &packages), "");
            order.map(|order| order.urdf.display().to_string())
        };
        assert_eq!(at("package://ur_description/urdf/ur5.urdf"), Ok("/opt/ur/urdf/ur5.urdf".to_owned()));
        assert_eq!(at("package://other/a.urdf"), Ok("relative/folder/a.urdf".to_owned()));
        assert_eq!(at("plain/a.urdf"), Ok("plain/a.urdf".to_owned()));
        let unknown = at("package://kuka/a.urdf").unwrap_err();
        assert!(unknown.contains("the folder of the package is not known, add --package kuka=DIR"), "{unknown}");
        assert!(at("package://kuka").unwrap_err().contains("must be package://NAME/FILE"));
        for wrong in ["ur", "=/opt", "ur=", "a/b=/opt"] {
            assert!(wrong.parse::<Package>().unwrap_err().starts_with("must be NAME=DIR"), "{wrong}");
        }
    }
}
