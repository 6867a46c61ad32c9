//! A test machine with CAN cards and a real-time kernel. QEMU emulates a PC with two Kvaser PCI cards on one bus.
//! Debian's PREEMPT_RT kernel boots in about five seconds on the host's own file system.
//!
//! The machine gives the guarantees of [`uml`](crate::uml). Interfaces `can0` and `can1` exist, down and without a bit
//! rate, as on a PC after power-on. `ip` and `can-utils` work on the interfaces as on any card. `vcan0` exists and is
//! up. `/dev/watchdog` is a hardware watchdog of 30 s. When the watchdog expires, the machine ends
//! ([`MachineError::Died`]). The machine proves function and never the timing of hardware: every instruction is
//! emulated, on one processor. The emulated bus has neither bit times nor acknowledgement.
//!
//! With [`Clock::Instructions`], a program that runs in real time behaves as if the host had no other work.
//!
//! Read [`Kernel`], then [`run`]. The machine's first process is `qemu-init.sh`.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, PipeReader, Read, Write};
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};

use thiserror::Error;

pub use crate::machine::{Cancellation, MachineError, Options};
use crate::machine::{Control, Machine, command_script, host, mount, quoted, replaced};

const QEMU: &str = "qemu-system-x86_64";
const BUSYBOX: &str = "/bin/busybox";
const INIT: &str = include_str!("qemu-init.sh");
/// Modules that the machine needs beside those built into the kernel, each after its dependencies.
const MODULES: [&str; 19] = [
    "drivers/virtio/virtio_ring",
    "drivers/virtio/virtio",
    "drivers/virtio/virtio_pci_legacy_dev",
    "drivers/virtio/virtio_pci_modern_dev",
    "drivers/virtio/virtio_pci",
    "drivers/char/virtio_console",
    "fs/netfs/netfs",
    "fs/fscache/fscache",
    "net/9p/9pnet",
    "net/9p/9pnet_virtio",
    "fs/9p/9p",
    "net/can/can",
    "net/can/can-raw",
    "drivers/net/can/dev/can-dev",
    "drivers/net/can/vcan",
    "drivers/net/can/sja1000/sja1000",
    "drivers/net/can/sja1000/kvaser_pci",
    "drivers/watchdog/watchdog",
    "drivers/watchdog/i6300esb",
];

/// Reasons why a test machine did not deliver the exit status of its command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[expect(missing_docs, reason = "the message says it")]
pub enum QemuError {
    #[error("{QEMU} is missing: `apt-get install qemu-system-x86`")]
    QemuMissing,
    /// BusyBox is not installed, or needs shared libraries, which the booting machine does not have.
    #[error("no static {BUSYBOX}: `apt-get install busybox-static`")]
    BusyboxMissing,
    #[error(
        "no PREEMPT_RT kernel: `apt-get download` the package that linux-image-rt-amd64 depends on and unpack \
         it with `dpkg -x PACKAGE target/qemu`"
    )]
    KernelMissing,
    #[error("the PREEMPT_RT kernel has no module {0}.ko: that of Debian 12 has it")]
    ModuleMissing(&'static str),
    #[error(transparent)]
    Machine(#[from] MachineError),
}

/// The clock of a machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Clock {
    /// The clock of the host. Programs in the machine are late while the host does other work.
    #[default]
    Host,
    /// A count of the executed instructions, 1 ns each. The clock stands still while the host does other work, and idle
    /// time passes at once. While its processor is busy, the machine needs about ten times as long as its clock shows.
    Instructions,
}

/// A PREEMPT_RT kernel of Debian 12, and the files needed to boot it.
#[derive(Clone, Debug)]
pub struct Kernel {
    image: PathBuf,
    modules: PathBuf,
}

impl Kernel {
    /// The kernel below `root`. `root` is the directory in which the kernel's package was unpacked, or `/` for an
    /// installed kernel.
    ///
    /// Of several kernels the last by name is taken.
    pub fn below(root: &Path) -> Result<Self, QemuError> {
        let path = std::env::var_os("PATH").unwrap_or_default();
        if !std::env::split_paths(&path).any(|place| place.join(QEMU).exists()) {
            return Err(QemuError::QemuMissing);
        }
        // A dynamically linked program contains the name of its dynamic loader.
        let dynamic = |program: Vec<u8>| program.windows(7).any(|bytes| bytes == b"/ld-lin");
        if fs::read(BUSYBOX).map_or(true, dynamic) {
            return Err(QemuError::BusyboxMissing);
        }
        Self::found_below(root)
    }

    fn found_below(root: &Path) -> Result<Self, QemuError> {
        let boot = fs::read_dir(root.join("boot")).map_err(|_| QemuError::KernelMissing)?;
        let version = |file: fs::DirEntry| {
            let name = file.file_name().into_string().ok()?;
            let version = name.strip_prefix("vmlinuz-")?;
            version.ends_with("-rt-amd64").then(|| version.to_owned())
        };
        let versions = boot.flatten().filter_map(version);
        let version = versions.max().ok_or(QemuError::KernelMissing)?;
        let kernel = Self {
            image: root.join(format!("boot/vmlinuz-{version}")),
            modules: root.join(format!("lib/modules/{version}/kernel")),
        };
        let missing = MODULES.iter().find(|module| !kernel.module(module).exists());
        missing.map_or(Ok(kernel), |module| Err(QemuError::ModuleMissing(module)))
    }

    fn module(&self, name: &str) -> PathBuf {
        self.modules.join(format!("{name}.ko"))
    }
}

/// Runs the command as [`uml::run`](crate::uml::run) does. The output of the command goes to `stdout` as it arrives.
/// The time-out of the options is in the time of the host.
pub fn run(kernel: &Kernel, clock: Clock, options: &Options, stdout: &mut dyn Write) -> Result<u8, QemuError> {
    let control = Control::new("qemu", options.output.as_deref())?;
    let machine = machine(control, kernel, clock, options).map_err(host("start the test machine"))?;
    let control = &machine.control;
    let initramfs = initramfs(kernel, options, control).map_err(host("read the kernel"))?;
    fs::write(control.path.join("initramfs"), initramfs).map_err(host("write the machine's directory"))?;
    machine.run(options.timeout, |piece| {
        // The command continues even if its output cannot be written.
        let _ = stdout.write_all(piece).and_then(|()| stdout.flush());
    })?;
    let result = machine.result(control.path.join("began").exists());
    if result == Err(MachineError::BootFailed) {
        // The boot error is returned. A failure to write the log is ignored.
        if let Ok(log) = fs::read(boot_log(control)) {
            let _ = stdout.write_all(&log);
        }
    }
    Ok(result?)
}

/// Messages of the kernel, of `qemu-init.sh` and of QEMU itself.
fn boot_log(control: &Control) -> PathBuf {
    control.path.join("boot.log")
}

/// A setting of QEMU that ends with a path. A comma separates settings; a double comma stands for a comma.
fn setting(before: &str, path: &Path, behind: &str) -> OsString {
    let path = replaced(path.as_os_str(), b',', b",,");
    OsString::from_vec([before.as_bytes(), &path, behind.as_bytes()].concat())
}

/// The machine, not started yet.
fn machine(control: Control, kernel: &Kernel, clock: Clock, options: &Options) -> io::Result<Machine> {
    let shared = |path, tag, access| {
        let behind = format!(",mount_tag={tag},security_model=none,{access}multidevs=remap");
        setting("local,path=", path, &behind)
    };
    let log = boot_log(&control);
    let words = |words: &str| words.split(' ').map(OsString::from).collect::<Vec<_>>();
    let option = |name: &str, value: OsString| vec![name.into(), value];
    let command = [
        vec![QEMU.into()],
        words("-accel tcg -smp 1 -nodefaults -no-reboot -display none -monitor none"),
        match clock {
            Clock::Host => Vec::new(),
            Clock::Instructions => words("-icount shift=0,sleep=off"),
        },
        option("-m", options.memory_mib.to_string().into()),
        option("-kernel", kernel.image.clone().into()),
        option("-initrd", control.path.join("initramfs").into()),
        option("-append", "console=ttyS0 quiet panic=-1 mitigations=off".into()),
        words("-object can-bus,id=bus -device kvaser_pci,canbus=bus -device kvaser_pci,canbus=bus -device i6300esb"),
        option("-chardev", setting("file,id=log,append=on,path=", &log, "")),
        words("-serial chardev:log -chardev stdio,id=output,signal=off"),
        words("-device virtio-serial-pci -device virtconsole,chardev=output"),
        option("-virtfs", shared(Path::new("/"), "host", "readonly=on,")),
        option("-virtfs", shared(&control.output, "output", "")),
        option("-virtfs", shared(&control.path, "control", "")),
    ]
    .concat();
    let log = File::options().create(true).append(true).open(&log)?;
    Machine::new(control, command, Some(log), read_pieces, &options.cancellation)
}

fn read_pieces(mut output: PipeReader, take: &mut dyn FnMut(Vec<u8>) -> bool) {
    let mut piece = [0; 4096];
    while let Ok(count @ 1..) = output.read(&mut piece) {
        if !take(piece[..count].to_vec()) {
            return;
        }
    }
}

/// The file system with which the kernel starts.
fn initramfs(kernel: &Kernel, options: &Options, control: &Control) -> io::Result<Vec<u8>> {
    let mut archive = Archive::default();
    let settings = [b"control=", &*quoted(control.path.as_os_str()), b"\n"].concat();
    archive.add("init", PROGRAM, INIT.as_bytes());
    archive.add("busybox", PROGRAM, &fs::read(BUSYBOX)?);
    archive.add("settings", DATA, &settings);
    archive.add("mounts", DATA, &mount_script(options, &control.output));
    archive.add("command", DATA, &command_script(options, &control.output));
    for (number, module) in MODULES.iter().enumerate() {
        let name = format!("{number:02}.ko");
        archive.add(&name, DATA, &fs::read(kernel.module(module))?);
    }
    Ok(archive.end())
}

/// A script that mounts [`Options::hidden`], then the output directory, which may lie in one of them.
fn mount_script(options: &Options, output: &Path) -> Vec<u8> {
    let hidden = options.hidden().into_iter().flat_map(|place| {
        let from = quoted(place.as_os_str());
        mount(&[b"-o bind /host", &*from].concat(), "/root", &place)
    });
    let writable = b"-t 9p -o trans=virtio,version=9p2000.L,rw,msize=262144 output";
    hidden.chain(mount(writable, "/root", output)).collect()
}

/// Modes of regular files.
const PROGRAM: u32 = 0o100_755;
const DATA: u32 = 0o100_644;

/// A cpio archive of the format `newc`. Each entry has `070701`, thirteen numbers of eight hexadecimal digits, the
/// name with a NUL, and the content. Name and content are each padded to four bytes (Linux,
/// driver-api/early-userspace/buffer-format).
#[derive(Default)]
struct Archive {
    bytes: Vec<u8>,
    files: u32,
}

impl Archive {
    fn add(&mut self, name: &str, mode: u32, content: &[u8]) {
        self.files += 1;
        let size = u32::try_from(content.len()).expect("no file of a kernel has 4 GiB");
        let name_size = name.len() as u32 + 1;
        // Inode, mode, owner, group, links, time, size, four device numbers, size of the name, checksum.
        let fields = [self.files, mode, 0, 0, 1, 0, size, 0, 0, 0, 0, name_size, 0];
        self.bytes.extend(b"070701");
        for field in fields {
            self.bytes.extend(format!("{field:08x}").bytes());
        }
        self.bytes.extend(name.bytes());
        self.bytes.push(0);
        self.fill_up();
        self.bytes.extend(content);
        self.fill_up();
    }

    fn fill_up(&mut self) {
        let whole = self.bytes.len().next_multiple_of(4);
        self.bytes.resize(whole, 0);
    }

    fn end(mut self) -> Vec<u8> {
        self.add("TRAILER!!!", 0, &[]);
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_archive_is_laid_out_as_the_kernel_reads_it() {
        let mut archive = Archive::default();
        archive.add("init", PROGRAM, b"hello");
        let zeros = "00000000".repeat(2);
        let expected = format!(
            "070701{}{}{zeros}{}{}{}{zeros}{zeros}{}{}init\0\0hello\0\0\0070701",
            "00000001", "000081ed", "00000001", "00000000", "00000005", "00000005", "00000000"
        );
        let bytes = archive.end();
        assert_eq!(String::from_utf8_lossy(&bytes[..expected.len()]), expected);
        assert_eq!(bytes.len() % 4, 0);
        assert!(bytes.ends_with(b"TRAILER!!!\0\0\0\0"));
    }

    #[test]
    fn what_would_be_hidden_is_mounted_from_the_host() {
        let options = Options { directory: "/tmp/a b".into(), ..Options::new(["sh"]) };
        assert_eq!(
            String::from_utf8(mount_script(&options, Path::new("/o"))).unwrap(),
            "mkdir -p /root'/tmp/a b'; mount -o bind /host'/tmp/a b' /root'/tmp/a b'\n\
             mkdir -p /root'/o'; mount -t 9p -o trans=virtio,version=9p2000.L,rw,msize=262144 output /root'/o'\n"
        );
    }

    #[test]
    fn a_directory_without_the_kernel_or_its_modules_is_refused() {
        let root = std::env::temp_dir().join(format!("mrroc-kernel-{}", std::process::id()));
        let refusal = || Kernel::found_below(&root).map(|_| ()).unwrap_err();
        assert_eq!(refusal(), QemuError::KernelMissing);
        fs::create_dir_all(root.join("boot")).unwrap();
        fs::write(root.join("boot/vmlinuz-6.1.0-9-amd64"), "").unwrap();
        assert_eq!(refusal(), QemuError::KernelMissing);
        fs::write(root.join("boot/vmlinuz-6.1.0-9-rt-amd64"), "").unwrap();
        assert_eq!(refusal(), QemuError::ModuleMissing(MODULES[0]));
        fs::remove_dir_all(root).unwrap();
    }
}
