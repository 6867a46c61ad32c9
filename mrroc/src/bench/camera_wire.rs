//! Connections to cameras: TCP with one thread per camera, or in memory in lockstep. Emulated cameras that listen.
//!
//! The servo has no part in a connection. A thread reads the bytes, and passes them to the receiver with the time of
//! their arrival. Each wait has a deadline. A lost connection is made again.

#![expect(clippy::disallowed_methods, reason = "the rim: reads clocks and waits")]

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use anyhow::{Context, anyhow};
use can::{Instant, clock};
use drive::camera::{CameraFault, CameraLink, CameraReceiver};
use hil::{Camera, World};

use crate::bench::BenchKind;
use crate::bench::cameras::{emulated, patience};
use crate::bench::emulation::Emulation;
use crate::cell::{self, CellFile};
use crate::run::crew;

/// Longest wait for a connection.
const CONNECT: Duration = Duration::from_secs(1);

/// Longest wait for bytes, and longest time between two checks for the end.
const LOOK: Duration = Duration::from_millis(20);

/// Time between two attempts to connect.
const RETRY: Duration = Duration::from_millis(200);

/// Longest wait until the host takes a frame of an emulated camera.
const WRITE: Duration = Duration::from_millis(500);

/// Bytes read at a time.
const CHUNK: usize = 1 << 15;

/// The cameras of a run. Their threads end with this value.
#[derive(Default)]
pub struct Cameras {
    links: Vec<CameraLink>,
    threads: Threads,
}

/// Threads that end when this value is dropped.
#[derive(Default)]
pub struct Threads {
    over: Arc<AtomicBool>,
    running: Vec<JoinHandle<()>>,
}

impl Threads {
    fn start(&mut self, work: impl FnOnce(&AtomicBool) + Send + 'static) -> anyhow::Result<()> {
        let over = self.over.clone();
        let crew = crew::current();
        let body = move || {
            let _member = crew::join(crew);
            work(&over);
        };
        let thread = Builder::new().name("camera".into()).spawn(body);
        self.running.push(thread.context("no thread for a camera can be made")?);
        Ok(())
    }
}

impl Drop for Threads {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        for thread in self.running.drain(..) {
            // A panic of such a thread was shown when it occurred. Its camera is silent from then on.
            let _ = thread.join();
        }
    }
}

impl Cameras {
    /// Connects to all cameras of a cell on `bench`, and waits for their greetings. `emulation`: the emulated cell, on the
    /// benches without hardware. An error names the camera that is absent, silent, garbled, or of another size or rate.
    pub fn open(file: &CellFile, bench: BenchKind, emulation: Option<&mut Emulation>) -> anyhow::Result<Self> {
        let mut cameras = Self::default();
        match emulation {
            Some(emulation) if bench == BenchKind::Lockstep => {
                for (number, given) in file.cell.camera.iter().enumerate() {
                    let link = emulation.add_camera(file, number);
                    cameras.links.push(link.map_err(|fault| refusal(given, &given.address, fault))?);
                }
            }
            Some(emulation) => {
                let here = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
                for (number, given) in file.cell.camera.iter().enumerate() {
                    let address = cameras.threads.serve(file, number, emulation.world_mut(), here)?;
                    cameras.connect(given, address)?;
                }
            }
            None => {
                for given in &file.cell.camera {
                    let address = given.address.parse().expect("a parsed cell has addresses of cameras");
                    cameras.connect(given, address)?;
                }
            }
        }
        Ok(cameras)
    }

    /// One link per camera, in the order of [`Cell::camera`](crate::cell::Cell::camera).
    pub fn links(&self) -> Vec<CameraLink> {
        self.links.clone()
    }

    fn connect(&mut self, given: &cell::Camera, address: SocketAddr) -> anyhow::Result<()> {
        let (mut receiver, link) = CameraReceiver::new(given.config());
        let refused = |fault| refusal(given, &address.to_string(), fault);
        let began = clock::now();
        let Ok(mut stream) = connected(address) else {
            return Err(refused(CameraFault::Absent { waited: clock::now().since(began) }));
        };
        receiver.connected(clock::now());
        let mut bytes = vec![0; CHUNK];
        let give_up = clock::now() + patience(receiver.config()) + LOOK;
        while !receiver.is_greeted() {
            if let Some(fault) = link.fault() {
                return Err(refused(fault));
            }
            if clock::now() > give_up {
                return Err(refused(CameraFault::Silent { age: clock::now().since(began) }));
            }
            read(&mut stream, &mut receiver, &mut bytes);
        }
        self.links.push(link);
        self.threads.start(move |over| listen(stream, receiver, bytes, address, over))
    }
}

/// The refusal of a camera, in the words of the cell.
fn refusal(given: &cell::Camera, address: &str, fault: CameraFault) -> anyhow::Error {
    anyhow!("camera {}, address {address}: {fault}", given.name)
}

fn connected(address: SocketAddr) -> std::io::Result<TcpStream> {
    let stream = TcpStream::connect_timeout(&address, CONNECT)?;
    stream.set_read_timeout(Some(LOOK))?;
    Ok(stream)
}

/// Reads once, and judges the age of the last picture. Returns whether the connection still exists.
fn read(stream: &mut TcpStream, receiver: &mut CameraReceiver, bytes: &mut [u8]) -> bool {
    let found = stream.read(bytes);
    let now = clock::now();
    let alive = match found {
        Ok(0) => false,
        Ok(count) => {
            receiver.receive(&bytes[..count], now);
            true
        }
        Err(error) => matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted),
    };
    if !alive {
        receiver.closed(now);
    }
    receiver.tick(now);
    alive
}

/// Receives until the end of the run, and connects again after the end of a connection.
fn listen(stream: TcpStream, mut receiver: CameraReceiver, mut bytes: Vec<u8>, address: SocketAddr, over: &AtomicBool) {
    let mut stream = Some(stream);
    while !over.load(Ordering::Relaxed) {
        crew::point("camera");
        match &mut stream {
            Some(open) => {
                if !read(open, &mut receiver, &mut bytes) {
                    stream = None;
                }
            }
            None => {
                clock::sleep_until(clock::now() + RETRY);
                stream = connected(address).ok();
                match stream {
                    Some(_) => receiver.connected(clock::now()),
                    None => receiver.tick(clock::now()),
                }
            }
        }
    }
}

impl Threads {
    /// Serves emulated camera `number` at `address`, and returns the bound address. An absent camera does not listen.
    pub fn serve(
        &mut self,
        file: &CellFile,
        number: usize,
        world: &mut World,
        address: SocketAddr,
    ) -> anyhow::Result<SocketAddr> {
        let given = &file.cell.camera[number];
        let named = || format!("camera {}, address {address}", given.name);
        let listener = TcpListener::bind(address).with_context(named)?;
        let bound = listener.local_addr().with_context(named)?;
        if given.emulator.absent {
            return Ok(bound);
        }
        listener.set_nonblocking(true).with_context(named)?;
        let camera = emulated(file, number, world);
        let silent_from = given.emulator.silent_from_s.map(Duration::from_secs_f64);
        self.start(move |over| serve(&listener, camera, silent_from, over))?;
        Ok(bound)
    }
}

/// Serves one host after the other until `over`.
fn serve(listener: &TcpListener, mut camera: Camera, silent_from: Option<Duration>, over: &AtomicBool) {
    let began = clock::now();
    while !over.load(Ordering::Relaxed) {
        match listener.accept() {
            // The host closes the connection, or takes too long.
            Ok((stream, _)) => drop(send(&stream, &mut camera, began, silent_from, over)),
            Err(_) => clock::sleep_until(clock::now() + LOOK),
        }
    }
}

fn send(
    mut stream: &TcpStream,
    camera: &mut Camera,
    began: Instant,
    silent_from: Option<Duration>,
    over: &AtomicBool,
) -> std::io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_write_timeout(Some(WRITE))?;
    let is_silent = |now: Instant| silent_from.is_some_and(|silent| now.since(began) >= silent);
    let mut bytes = Vec::new();
    if !is_silent(clock::now()) {
        camera.greet(&mut bytes);
        stream.write_all(&bytes)?;
    }
    let period = camera.config().period;
    let mut next = clock::now() + period;
    while !over.load(Ordering::Relaxed) {
        clock::sleep_until(next.min(clock::now() + LOOK));
        let now = clock::now();
        if now < next {
            continue;
        }
        // A late picture delays the following ones.
        next = (next + period).max(now);
        if !is_silent(now) {
            bytes.clear();
            camera.expose(Instant::ZERO + now.since(began), &mut bytes);
            stream.write_all(&bytes)?;
        }
    }
    Ok(())
}
