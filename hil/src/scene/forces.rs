//! One step of the bodies, and the forces on the robots at the end of the step.

use nalgebra::{Matrix3, Vector3};

use super::arm::Arm;
use super::body::Body;
use super::contact::{Push, Surface, at_instant, clearance, over_step};
use super::motion::{Motion, Wrench};
use super::{
    CornersOn, Grip, Ground, Holder, REPETITIONS, RobotId, SOLVED, STEP_SECONDS, Scene, Shape, TipOn, Wall, grip,
};

impl Scene {
    /// Moves the bodies over a part of the present step: from the share `from` of the step to the share `to`. A part
    /// that cannot be solved is halved, up to `halvings` times.
    pub(super) fn move_bodies(&mut self, from: f64, to: f64, halvings: u32) {
        if self.bodies.is_empty() {
            return;
        }
        let solved = self.solve(from, to);
        if solved || halvings == 0 {
            if !solved {
                self.unsolved.add();
            }
            self.finish_bodies();
            return;
        }
        let middle = 0.5 * (from + to);
        self.move_bodies(from, middle, halvings - 1);
        self.move_bodies(middle, to, halvings - 1);
    }

    /// Computes the end of a part of the step. Returns whether the iteration has converged.
    fn solve(&mut self, from: f64, to: f64) -> bool {
        let dt = (to - from) * STEP_SECONDS;
        for arm in &mut self.arms {
            arm.set_motion(from, to, dt);
        }
        for body in &mut self.bodies {
            body.begin(dt);
        }
        for grip in self.grips.iter().flatten() {
            let body = &mut self.bodies[grip.body];
            let arm = body.motion.axes[0] * grip.held.point;
            let (linear, turning) = grip.config.resistance(dt);
            body.resist(&arm, linear, turning, dt);
        }
        for _ in 0..REPETITIONS {
            self.push_bodies(dt);
            let mut solved = true;
            for body in &mut self.bodies {
                let change = body.improve(dt);
                solved &= change <= SOLVED.0 + SOLVED.1 * body.velocity.norm();
            }
            if solved {
                return true;
            }
        }
        false
    }

    /// Forces on all bodies over a part of the step, for the present guess of its end.
    fn push_bodies(&mut self, dt: f64) {
        let Self { walls, bodies, arms, corners, tips, grips, gravity, .. } = self;
        for body in bodies.iter_mut() {
            body.wrench = Wrench { force: body.mass * *gravity, torque: Vector3::zeros() };
        }
        for pair in corners {
            if far(&bodies[pair.body], pair.ground, walls, bodies) {
                pair.next = CornersOn::LOOSE;
                continue;
            }
            for (corner, (bristle, next)) in pair.bristles.iter().zip(&mut pair.next).enumerate() {
                let body = &bodies[pair.body];
                let (surface, ground) = ground(pair.ground, walls, bodies);
                let push = over_step(&body.corners[corner], &body.motion, surface, ground, bristle, dt);
                *next = push.map_or(Vector3::zeros(), |push| push.bristle);
                if let Some(push) = push {
                    bodies[pair.body].take(&push, 1.0);
                    if let Ground::Body(other) = pair.ground {
                        bodies[other].take(&push, -1.0);
                    }
                }
            }
        }
        for pair in tips {
            let Ground::Body(number) = pair.ground else {
                continue;
            };
            if pair.inside {
                pair.next = Vector3::zeros();
                continue;
            }
            let (arm, body) = (&arms[pair.arm], &mut bodies[number]);
            let push = over_step(&arm.tips()[pair.tip], &arm.motion, &body.surface, &body.motion, &pair.bristle, dt);
            pair.next = push.map_or(Vector3::zeros(), |push| push.bristle);
            if let Some(push) = push {
                body.take(&push, -1.0);
            }
        }
        for grip in grips.iter().flatten() {
            let holder = match grip.holder {
                Holder::Robot(RobotId(arm)) => arms[arm].motion,
                Holder::World => Motion::standing(Vector3::zeros(), Matrix3::identity()),
            };
            let body = &mut bodies[grip.body];
            let hold = grip::over_step(&grip.config, (&holder, &grip.anchor), (&body.motion, &grip.held), dt);
            body.push(&hold.point, &hold.force);
            body.wrench.torque += hold.torque;
        }
    }

    fn finish_bodies(&mut self) {
        for body in &mut self.bodies {
            body.finish();
        }
        for pair in &mut self.corners {
            pair.bristles = pair.next;
        }
        for pair in &mut self.tips {
            if let Ground::Body(_) = pair.ground {
                pair.bristle = pair.next;
            }
        }
    }

    /// Computes the forces on the tips of all robots at the end of the step.
    pub(super) fn push_tips(&mut self) {
        let Self { walls, bodies, arms, tips, grips, .. } = self;
        arms.iter_mut().for_each(Arm::begin_clearance);
        for pair in tips {
            pair.push(&mut arms[pair.arm], walls, bodies, grips);
        }
    }

    /// Computes the forces of all grippers at the end of the step.
    pub(super) fn pull_grips(&mut self) {
        let Self { bodies, arms, grips, .. } = self;
        for grip in grips.iter_mut().flatten() {
            let body = bodies[grip.body].moving();
            let Holder::Robot(RobotId(arm)) = grip.holder else {
                let holder = super::Moving::WORLD;
                grip.hold = grip::at_instant(&grip.config, (&holder, &grip.anchor), (&body, &grip.held));
                continue;
            };
            let arm = &mut arms[arm];
            grip.hold = grip::at_instant(&grip.config, (&arm.flange, &grip.anchor), (&body, &grip.held));
            let origin = arm.flange.origin;
            grip.hold.pull(&mut arm.wrench, &origin);
        }
    }
}

impl TipOn {
    /// Computes the force on the tip at the end of the step.
    pub(super) fn push(&mut self, arm: &mut Arm, walls: &[Wall], bodies: &[Body], grips: &[Option<Grip>]) {
        if arm.is_far() {
            return;
        }
        let sphere = arm.tips()[self.tip];
        let push = match self.ground {
            Ground::Wall(wall) => {
                let wall = &walls[wall];
                // The bristle of a tip on a wall is displaced once per step, here, by the motion over the whole step.
                let push = at_instant(&sphere, &arm.flange, &wall.surface, &wall.moving, &self.bristle, STEP_SECONDS);
                self.bristle = push.map_or(Vector3::zeros(), |push| push.bristle);
                let distance = clearance(&sphere, &arm.flange, &wall.surface, &wall.moving);
                arm.limit_clearance(distance.max(0.0));
                push
            }
            Ground::Body(number) if self.inside => {
                let body = &bodies[number];
                self.inside = holds(grips, self.arm, number)
                    || clearance(&sphere, &arm.flange, &body.surface, &body.moving()) < 0.0;
                None
            }
            Ground::Body(body) => {
                let body = &bodies[body];
                at_instant(&sphere, &arm.flange, &body.surface, &body.moving(), &self.bristle, 0.0)
            }
        };
        if let Some(push) = push {
            arm.push_tip(&push.centre, &push.normal);
            arm.push_tip(&push.touch, &push.drag);
        }
    }
}

impl Body {
    /// Adds a contact with this body to the forces over the present step, times `sign`.
    fn take(&mut self, push: &Push, sign: f64) {
        self.push(&push.centre, &(sign * push.normal));
        self.push(&push.touch, &(sign * push.drag));
    }
}

/// The surface behind a contact, and its motion over the step.
fn ground<'a>(ground: Ground, walls: &'a [Wall], bodies: &'a [Body]) -> (&'a Surface, &'a Motion) {
    match ground {
        Ground::Wall(wall) => (&walls[wall].surface, &walls[wall].motion),
        Ground::Body(body) => (&bodies[body].surface, &bodies[body].motion),
    }
}

/// Whether no corner of a body can touch a surface at the beginning or at the end of the step.
fn far(body: &Body, on: Ground, walls: &[Wall], bodies: &[Body]) -> bool {
    let (surface, ground) = ground(on, walls, bodies);
    let reach = body.surface.shape.extent();
    (0..2).all(|end| {
        let arm = body.motion.origin[end] - ground.origin[end];
        match surface.shape {
            Shape::HalfSpace => arm.dot(&ground.axes[end].column(2)) > reach,
            Shape::Box { .. } => {
                let sum = reach + surface.shape.extent();
                arm.norm_squared() > sum * sum
            }
        }
    })
}

/// Whether a robot holds a body.
pub(super) fn holds(grips: &[Option<Grip>], arm: usize, body: usize) -> bool {
    grips.iter().flatten().any(|grip| grip.body == body && grip.holder == Holder::Robot(RobotId(arm)))
}
