//! Motors of chains and linkages with coupled dynamics advance without allocations.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;

use mrroc_hil::plant::{ChainBodies, ChainBodyJoint, LinkBody, LinkPoses, LinkageBodies};
use mrroc_hil::{AxisConfig, Demand, Mechanism, MechanismConfig, PlantAxis};
use nalgebra::{Isometry3, Vector3};

/// Counts the requests of this thread to the system allocator.
struct Counting;

thread_local! {
    static CALLS: Cell<u64> = const { Cell::new(0) };
}

fn count() {
    CALLS.with(|calls| calls.set(calls.get() + 1));
}

// SAFETY: every call is forwarded unchanged to the system allocator.
#[expect(unsafe_code, reason = "an allocator cannot be written without")]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller guarantees the contract.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count();
        // SAFETY: the caller guarantees the contract.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn chains_advance_without_allocations() {
    let joint = |number: usize| ChainBodyJoint {
        translation: [0.2, 0.0, 0.1],
        rotation: [1.0, 0.0, 0.0, 0.0],
        axis: [0.0, (number % 2) as f64, 1.0],
        prismatic: number == 5,
        mass: 2.0,
        centre: [0.1, 0.0, 0.05],
        inertia: [0.02, 0.03, 0.04, 0.0, 0.0, 0.0],
        at_home: 0.1,
    };
    let joints: Vec<_> = (0..8).map(joint).collect();
    let rows: Vec<Vec<f64>> =
        (0..8).map(|row| (0..8).map(|column| if row == column { 0.02 } else { 0.0 }).collect()).collect();
    let flange = ([0.0; 3], [1.0, 0.0, 0.0, 0.0]);
    let bodies = ChainBodies::new(&joints, flange, [0.0, 0.0, 1.0], &rows, &[1e-4; 8]).unwrap();
    advances_without_allocations(&Mechanism::new(MechanismConfig::Chain(Arc::new(bodies))), 200);
}

/// A chain of rods. Their joints turn about z and y alternately.
#[derive(Debug)]
struct Rods;

impl LinkPoses for Rods {
    fn place(&self, motors: &[f64], poses: &mut [Isometry3<f64>]) -> bool {
        let mut place = Isometry3::identity();
        for (number, (pose, motor)) in poses.iter_mut().zip(motors).enumerate() {
            let axis = if number % 2 == 0 { Vector3::z() } else { Vector3::y() };
            place *= Isometry3::rotation(axis * (0.02 * motor));
            *pose = place;
            place *= Isometry3::translation(0.2, 0.0, 0.0);
        }
        poses[motors.len()] = place;
        true
    }
}

#[test]
fn linkages_advance_without_allocations() {
    let links = [LinkBody::rod(2.0, 0.2); 8];
    let bodies = LinkageBodies::new(Arc::new(Rods), &links, [0.0, 0.0, 1.0], &[50.0; 8], &[1e-4; 8]).unwrap();
    advances_without_allocations(&Mechanism::new(MechanismConfig::Linkage(Arc::new(bodies))), 60);
}

fn advances_without_allocations(mechanism: &Mechanism, periods: u32) {
    let config = AxisConfig { start_angle: 0.0, ..AxisConfig::polycrank(0).expect("it has the axis") };
    let mut axes: Vec<PlantAxis> = (0..8)
        .map(|number| PlantAxis::mounted(&config, number as u64, mechanism.mount(number, 0.0).as_ref()))
        .collect();
    let before = CALLS.with(Cell::get);
    for period in 0..periods {
        for axis in &mut axes {
            axis.advance(20, Demand::Velocity(2000.0));
        }
        if period % 50 == 0 {
            mechanism.set_payload(f64::from(period) * 0.01, [0.0, 0.0, 0.1]);
        }
        for number in 0..8 {
            assert!(mechanism.load(number).inertia > 0.0);
        }
        assert!(mechanism.effective_mass([0.0; 3], [0.0, 0.0, 1.0]) > 0.0);
    }
    assert_eq!(CALLS.with(Cell::get) - before, 0);
    let angles: Vec<f64> = axes.iter().map(PlantAxis::angle).collect();
    assert!(angles.iter().all(|angle| angle.abs() > 0.1), "{angles:?}");
}
