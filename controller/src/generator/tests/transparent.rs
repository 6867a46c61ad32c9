//! A transparent member of a team: orders, answers and refusals of one step.

use std::any::{Any, TypeId};

use super::*;

type Order = Option<Setpoint>;

/// A standing effector and a coordinator.
struct Team {
    order: Received<Order>,
    answers: usize,
}

impl Partners for Team {
    fn effector(&self) -> Result<EffectorImage, GeneratorError> {
        Standing::at([0.2; 8]).effector()
    }
    fn gives_orders(&self, order: TypeId) -> bool {
        order == TypeId::of::<Order>()
    }
    fn order(&self, order: TypeId) -> Option<&dyn Any> {
        self.gives_orders(order).then_some(&self.order)
    }
    fn answer(&mut self, answer: &dyn Any) -> bool {
        self.answers += 1;
        answer.downcast_ref::<EffectorImage>().is_some_and(|e| e.commanded.joints.position == [0.2; 8])
    }
}

fn new(order: Order) -> Received<Order> {
    Received::New(Sample { at: can::Instant::ZERO, age: Duration::ZERO, value: order })
}

#[test]
fn a_transparent_member_sends_each_order_unchanged_and_answers_its_image() {
    let mut run = Run::new(Transparent);
    let Description { first, every, .. } = run.description();
    assert_eq!((first, every), (5, 5));
    let mut team = Team { order: new(None), answers: 0 };
    assert_eq!(begin(&mut run, &mut team, MACROSTEP), Ok(Step::Continue(EffectorCommand::default())));
    let orders = [
        Some(Setpoint::Joints(AxesState::new([0.3; 8], [1.0; 8]))),
        Some(Setpoint::Motors(AxesState::at_rest([7.0; 8]))),
        Some(Setpoint::Tool(crate::path::PoseState::default())),
        None,
    ];
    for (step, order) in orders.into_iter().enumerate() {
        team.order = new(order);
        assert_eq!(run.next_step(&mut team), Ok(Step::Continue(EffectorCommand { setpoint: order, law: None })));
        assert_eq!(team.answers, step + 2);
    }
}

#[test]
fn an_order_that_is_missing_old_or_not_finite_is_refused_without_an_answer() {
    let mut joints = AxesState::at_rest([0.3; 8]);
    joints.velocity[2] = f64::NAN;
    let lost = new(Some(Setpoint::Joints(joints)));
    let sample = Sample { at: can::Instant::ZERO, age: Duration::ZERO, value: None };
    for (order, refusal) in [
        (lost, GeneratorError::OrderNotFinite { axis: 2 }),
        (Received::Old(sample), GeneratorError::NoNewOrder),
        (Received::None, GeneratorError::NothingReceived),
    ] {
        let mut team = Team { order, answers: 0 };
        assert_eq!(begin(&mut Run::new(Transparent), &mut team, MACROSTEP), Err(refusal));
        let mut run = Run::new(Transparent);
        team.order = new(None);
        assert_eq!(begin(&mut run, &mut team, MACROSTEP), Ok(Step::Continue(EffectorCommand::default())));
        (team.order, team.answers) = (order, 0);
        assert_eq!(run.next_step(&mut team), Err(refusal));
        assert_eq!(team.answers, 0);
    }
}
