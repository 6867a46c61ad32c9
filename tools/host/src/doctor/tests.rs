//! Small file trees in place of a host, complete and damaged.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};

use can::OpenError;
use mrroc::cell::Realtime;

use super::finding::Finding;
use super::link::Link;
use super::tree::Tree;
use super::{can_interfaces, cpu, kernel, limits, serial_lines};

/// A file tree that is deleted when the test ends.
pub(super) struct Fake(PathBuf);

impl Fake {
    /// Creates files from their paths and texts.
    pub(super) fn new(files: &[(&str, &str)]) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = format!("mrroc-doctor-{}-{number}", std::process::id());
        let fake = Self(std::env::temp_dir().join(name));
        fs::create_dir(&fake.0).unwrap();
        for (path, text) in files {
            fs::write(fake.ready(path), text).unwrap();
        }
        fake
    }

    /// Creates a symbolic link. `target` is relative to the directory of the link.
    pub(super) fn link(&self, path: &str, target: &str) {
        symlink(target, self.ready(path)).unwrap();
    }

    pub(super) fn tree(&self) -> Tree {
        Tree::new(&self.0)
    }

    pub(super) fn text(&self, path: &str) -> Option<String> {
        fs::read_to_string(self.0.join(path)).ok()
    }

    pub(super) fn write(&self, path: &str, text: &str) {
        fs::write(self.ready(path), text).unwrap();
    }

    /// Path of a file in the tree.
    pub(super) fn path(&self, path: &str) -> PathBuf {
        self.0.join(path)
    }

    fn ready(&self, path: &str) -> PathBuf {
        let path = self.0.join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        path
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// All findings in a tree. The cell names can0 and ttyUSB0, and pins its servo thread.
fn all(tree: &Tree, link: Option<&Link>) -> Vec<Finding> {
    let realtime = Realtime { cpu: Some(1), ..Realtime::default() };
    let interface = can_interfaces::Wanted {
        of: "bus".into(),
        interface: "can0".into(),
        bitrate_kbps: Some(u32::MAX),
        send_queue: 9,
        servo_cpu: Some(1),
    };
    let line = serial_lines::Wanted { of: "axis".into(), path: "/dev/ttyUSB0".into() };
    let stat = tree.text("/proc/stat").unwrap_or_default();
    let down = Err(OpenError::Down(can::InterfaceName::new("can0").unwrap()));
    let mut found = kernel::findings(tree, Some(0), false);
    found.extend(limits::findings(tree, &realtime, Ok(())));
    found.extend(cpu::findings(tree, &realtime));
    found.extend(can_interfaces::findings(tree, &interface, down, link));
    found.extend(serial_lines::findings(tree, &line));
    found.push(cpu::steal(&stat, "", &stat));
    found
}

#[test]
fn what_cannot_be_understood_is_a_finding_and_no_panic() {
    const FILES: [&str; 26] = [
        "proc/version",
        "proc/stat",
        "proc/self/cgroup",
        "proc/self/status",
        "proc/self/limits",
        "proc/sys/kernel/osrelease",
        "proc/sys/kernel/sched_rt_runtime_us",
        "proc/sys/kernel/sched_rt_period_us",
        "proc/irq/7/smp_affinity_list",
        "boot/config-0",
        "dev/cpu_dma_latency",
        "dev/ttyUSB0",
        "etc/security/limits.d/mrroc.conf",
        "sys/kernel/realtime",
        "sys/class/net/can0/type",
        "sys/class/net/can0/tx_queue_len",
        "sys/class/net/can0/device/irq",
        "sys/class/tty/ttyUSB0/type",
        "sys/bus/usb-serial/devices/ttyUSB0/latency_timer",
        "sys/devices/system/cpu/online",
        "sys/devices/system/cpu/isolated",
        "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor",
        "sys/devices/system/cpu/cpu0/cpuidle/state0/name",
        "sys/devices/system/cpu/cpu0/cpuidle/state0/latency",
        "sys/devices/system/cpu/cpu0/cpuidle/state0/disable",
        "sys/fs/cgroup/cpu/cpu.rt_runtime_us",
    ];
    let wild = [
        "",
        "\0",
        "-1",
        "0",
        "9223372036854775807",
        "-9223372036854775808",
        "0-18446744073709551615",
        "0::/\n4:cpu:/",
        "Uid: x\nCapEff: zz\nCpus_allowed_list: 9-1",
        "ł€😀 : ,-,-, :",
    ];
    let links = [
        "[{}]",
        r#"[{"linkinfo":{"info_kind":"can","info_data":{"bittiming":{"bitrate":4294967295,"sample_point":"NaN"}}}}]"#,
    ];
    let links: Vec<_> = links.map(|link| Link::parse(link).unwrap()).into();
    for text in wild {
        let fake = Fake::new(&FILES.map(|path| (path, text)));
        for link in [None].into_iter().chain(links.iter().map(Some)) {
            let found = all(&fake.tree(), link);
            assert!(found.len() > 9, "{text:?}: {found:#?}");
            for finding in found {
                let mended = finding.mend.is_some() || finding.fixes.is_empty();
                assert!(!finding.read.is_empty() && mended, "{text:?}: {finding:?}");
            }
        }
    }
    assert!(all(&Fake::new(&[]).tree(), None).len() > 7);
}
