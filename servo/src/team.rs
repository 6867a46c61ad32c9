//! Coordination of the effectors of a cell: barriers, and teams that begin and stop their macrosteps together.
//!
//! Each effector first checks its axes and takes its stops. [`coordinate`] then decides for all effectors. Last, each
//! effector takes its set-points. An effector without partners is a team with one member. The result does not depend on
//! the order of the effectors. [`TeamState`] describes the states of a team.

use crate::effector::{Effector, Tick};
use crate::state::TeamEvent;
use crate::{Macrostep, ServoState, StopCause, TeamState};

/// Barriers that one effector may pass in one cycle. Barriers beyond wait for the next cycle.
const BARRIERS: usize = 4;

/// The team of an effector. Each member has a copy. The copies agree, except that each member leaves
/// [`TeamState::Parting`] by itself.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Team {
    pub(crate) state: TeamState,
    /// Bit set of the members, the effector included.
    members: u32,
    /// Number of macrosteps begun since the tie.
    pub(crate) macrosteps: u64,
    /// Number of the first of these macrosteps in its effector.
    first: Option<u64>,
}

impl Team {
    /// An effector apart.
    pub(crate) fn apart(bit: u32) -> Self {
        Self { state: TeamState::Apart, members: bit, macrosteps: 0, first: None }
    }

    /// Takes an event, for the member of this bit.
    fn take(&mut self, event: TeamEvent, bit: u32) {
        self.state = self.state.next(event);
        if self.state == TeamState::Apart {
            self.members = bit;
        }
    }

    /// The required number of the next macrostep of the effector; `None` before the first, and apart.
    pub(crate) fn next_number(&self) -> Option<u64> {
        self.first.filter(|_| self.state.is_tied()).map(|first| first.wrapping_add(self.macrosteps))
    }

    /// Counts a macrostep that the whole team begins.
    fn count(&mut self, number: u64) {
        self.first.get_or_insert(number);
        self.macrosteps += 1;
    }
}

impl Effector {
    /// Whether the effector is in a team with others.
    pub(crate) fn is_tied(&self) -> bool {
        self.team.state.is_tied()
    }

    /// Bit set of the effectors that begin and stop together: the tied members, or this effector alone.
    fn tied(&self) -> u32 {
        if self.is_tied() { self.team.members } else { self.bit() }
    }

    /// Ties the effector to the other `members`.
    pub(crate) fn tie(&mut self, members: u32) {
        self.team = Team { members, ..Team::apart(self.bit()) };
        let event = if members == self.bit() { TeamEvent::Untie } else { TeamEvent::Tie };
        self.change_team(event);
    }

    /// Leaves the team.
    pub(crate) fn untie(&mut self) {
        self.change_team(TeamEvent::Untie);
    }

    /// Begins a macrostep of this number with the team.
    pub(crate) fn begin_with_team(&mut self, number: u64) {
        self.change_team(TeamEvent::Begin);
        if self.is_tied() {
            self.team.count(number);
        }
    }

    fn change_team(&mut self, event: TeamEvent) {
        let bit = self.bit();
        self.team.take(event, bit);
    }
}

/// Decides what each effector does in this cycle. Stops were found in the checks and the queues of all effectors
/// before.
pub(crate) fn coordinate(effectors: &mut [Effector], tick: &Tick) {
    rest_teams(effectors);
    stop_teams(effectors, tick);
    for _ in 0..BARRIERS {
        if !pass_barriers(effectors, tick) {
            break;
        }
        stop_teams(effectors, tick);
    }
    effectors.iter_mut().for_each(|effector| effector.restart_refused_stop(tick));
    hold_partners(effectors);
    for index in 0..effectors.len() {
        let members = effectors[index].tied();
        // The first member decides for its team.
        if members.trailing_zeros() as usize == index {
            follow_macrosteps(effectors, members, tick);
        }
    }
    stop_teams(effectors, tick);
}

fn of(effectors: &[Effector], members: u32) -> impl Iterator<Item = &Effector> {
    effectors.iter().filter(move |it| it.bit() & members != 0)
}

fn of_mut(effectors: &mut [Effector], members: u32) -> impl Iterator<Item = &mut Effector> {
    effectors.iter_mut().filter(move |it| it.bit() & members != 0)
}

/// Finds the teams that have come to rest.
fn rest_teams(effectors: &mut [Effector]) {
    for index in 0..effectors.len() {
        let effector = &effectors[index];
        let rests = match effector.team.state {
            TeamState::Apart | TeamState::Tied => false,
            TeamState::Moving | TeamState::Settling => {
                of(effectors, effector.team.members).all(|it| it.state == ServoState::Standing)
            }
            TeamState::Parting => !effector.is_braking(),
        };
        if rests {
            effectors[index].change_team(TeamEvent::Rest);
        }
    }
}

/// Removes from each team the members that have left it, and stops the teams of which a member was stopped. All motors
/// of a team take the same number of periods to rest, that of the slowest motor.
fn stop_teams(effectors: &mut [Effector], tick: &Tick) {
    for index in 0..effectors.len() {
        let (own, members) = (effectors[index].bit(), effectors[index].team.members);
        let mutual = of(effectors, members).filter(|it| it.team.members & own != 0);
        let mutual = mutual.fold(0, |all, it| all | it.bit());
        effectors[index].team.members = mutual;
        if mutual == own {
            effectors[index].untie();
        }
    }
    for index in 0..effectors.len() {
        let members = effectors[index].team.members;
        if !effectors[index].stopped || !effectors[index].is_tied() {
            continue;
        }
        for member in of_mut(effectors, members) {
            member.change_team(TeamEvent::Stop);
            if !member.stopped {
                member.stop_with(index as u8, tick);
            }
        }
        let periods = of(effectors, members).filter_map(Effector::stop_periods).max().unwrap_or(0);
        of_mut(effectors, members).for_each(|member| member.brake_over(periods));
    }
    effectors.iter_mut().for_each(|effector| effector.stopped = false);
}

/// Lets the effectors pass whose partners stand at an equal barrier. Returns whether any has passed.
fn pass_barriers(effectors: &mut [Effector], tick: &Tick) -> bool {
    let mut passing = 0;
    for barrier in effectors.iter().filter_map(|it| it.barrier(tick)) {
        let members = barrier.members();
        if of(effectors, members).all(|it| it.barrier(tick) == Some(barrier)) {
            passing |= members;
        }
    }
    for effector in of_mut(effectors, passing) {
        if let Some(barrier) = effector.barrier(tick) {
            effector.pass(barrier, tick);
        }
    }
    passing != 0
}

/// Repeats the set-points of a team while a bus refuses those of a member. The members then stay in step, as the axes
/// of one effector do.
fn hold_partners(effectors: &mut [Effector]) {
    let repeating = |state: fn(ServoState) -> bool| {
        let refused = effectors.iter().filter(|it| it.must_repeat() && state(it.state));
        refused.fold(0, |all, it| all | it.bit())
    };
    let moving = repeating(|state| state == ServoState::Moving);
    let braking = repeating(|state| matches!(state, ServoState::Braking(_)));
    for effector in effectors {
        let partners = match effector.state {
            ServoState::Moving => effector.tied() & moving,
            ServoState::Braking(_) => effector.team.members & braking,
            ServoState::Off
            | ServoState::Enabling
            | ServoState::Standing
            | ServoState::Homing
            | ServoState::Halting(_)
            | ServoState::Faulted
            | ServoState::Resetting => 0,
        };
        effector.held = partners != 0 || effector.must_repeat();
    }
}

/// Finds the next set-points of a team. The members begin a macrostep in the same cycle or not at all.
fn follow_macrosteps(effectors: &mut [Effector], members: u32, tick: &Tick) {
    if of(effectors, members).any(|it| it.held) {
        return;
    }
    // Orders may arrive at any time: each queue is asked once.
    let ready = of(effectors, members).filter(|it| it.next_macrostep(tick).is_some());
    let ready = ready.fold(0, |all, it| all | it.bit());
    let begin = ready == members;
    if !begin && of(effectors, members).any(|it| it.runs_out_in_motion(tick)) {
        of_mut(effectors, members & !ready).for_each(|member| member.starve(tick));
    } else if !begin || admit(effectors, members, tick) {
        of_mut(effectors, members).for_each(|member| member.follow_macrosteps(begin, tick));
        let settling = |it: &Effector| it.settling.then(|| it.stop_periods()).flatten();
        if let Some(periods) = of(effectors, members).filter_map(settling).max() {
            of_mut(effectors, members).filter(|it| it.settling).for_each(|it| it.brake_over(periods));
            of_mut(effectors, members).for_each(|it| it.change_team(TeamEvent::Settle));
        }
    }
}

/// Checks the next macrosteps of a team. A member whose macrostep cannot be begun is stopped; false then.
fn admit(effectors: &mut [Effector], members: u32, tick: &Tick) -> bool {
    let mut sound = true;
    for member in of_mut(effectors, members) {
        sound &= member.admit_next(tick);
    }
    if !sound {
        return false;
    }
    let steps = of(effectors, members).filter_map(|it| it.next_macrostep(tick)).map(|next| next.steps);
    let (shortest, longest) = steps.fold((u16::MAX, 0), |(least, most), it| (least.min(it), most.max(it)));
    if shortest == longest {
        return true;
    }
    for member in of_mut(effectors, members) {
        if let Some(&Macrostep { number, steps, .. }) = member.next_macrostep(tick) {
            let other = if steps == shortest { longest } else { shortest };
            member.refuse_next(tick, None, StopCause::UnequalSteps { number, steps, other });
        }
    }
    false
}
