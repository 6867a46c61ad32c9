//! Questions of tasks to an operator.

use controller::sensor::{OperatorError, OperatorLink, OperatorPanel};

use super::*;

/// Runs a task in lockstep with an operator who gives these lines. Returns the report, and the texts that the operator
/// saw.
fn operated(
    lines: &[&str],
    steps: Option<&Path>,
    task: impl AsyncFn(&mut Cell) -> Outcome + Send + Sync + 'static,
) -> (anyhow::Result<RunReport>, Vec<String>) {
    let (link, OperatorPanel { lines: sender, texts }) = OperatorLink::new(100);
    lines.iter().for_each(|line| sender.send((*line).to_owned()).unwrap());
    drop(sender);
    let options = RunOptions { steps: steps.map(Path::to_owned), ..RunOptions::on(BenchKind::Lockstep) };
    let program = Program::of(task).with_operator(link);
    let report = crate::run::run(&two_arms(), &options, &Requests::default(), &program, &mut |_| {});
    (report, texts.try_iter().collect())
}

fn next_motion() -> Question {
    Question::new("Next motion?", ["yes", "no"])
}

#[test]
fn a_task_asks_until_a_line_is_a_choice_and_rehearsals_take_their_own_answer() {
    let (rehearsals, runs) = (Arc::new(AtomicU32::new(0)), Arc::new(AtomicU32::new(0)));
    let counts = [Arc::clone(&rehearsals), Arc::clone(&runs)];
    let (report, texts) = operated(&["perhaps", "NO", "a name"], None, async move |cell: &mut Cell| {
        let answer = cell.ask(next_motion().rehearsed("yes")).await?;
        assert_eq!(answer, if cell.rehearsing() { "yes" } else { "no" });
        cell.tell("hello");
        let name = cell.ask(Question::open("Name?").rehearsed("none")).await?;
        assert_eq!(name, if cell.rehearsing() { "none" } else { "a name" });
        counts[usize::from(!cell.rehearsing())].fetch_add(1, Ordering::Relaxed);
        Ok(())
    });
    assert_eq!(report.unwrap().outcome, RunOutcome::Completed);
    assert_eq!((rehearsals.load(Ordering::Relaxed), runs.load(Ordering::Relaxed)), (1, 1));
    let refusal = "\"perhaps\" is no answer; answers are yes, no";
    assert_eq!(texts, ["Next motion? [yes/no]", refusal, "hello", "Name?"]);
}

#[test]
fn a_task_tells_its_messages_without_an_operator_and_its_questions_stay_refused() {
    let (link, OperatorPanel { texts, .. }) = OperatorLink::new(10);
    let told = |task: Program| {
        let options = RunOptions::on(BenchKind::Lockstep);
        crate::run::run(&two_arms(), &options, &Requests::default(), &task.with_texts(link.clone()), &mut |_| {})
    };
    let report = told(Program::of(async |cell: &mut Cell| {
        cell.tell("hello");
        Ok(())
    }));
    assert_eq!(report.unwrap().outcome, RunOutcome::Completed);
    // Once, and not in the rehearsal.
    assert_eq!(texts.try_iter().collect::<Vec<_>>(), ["hello"]);
    let refused = told(Program::of(async |cell: &mut Cell| cell.ask(next_motion().rehearsed("yes")).await.map(|_| ())));
    assert!(format!("{:#}", refused.unwrap_err()).contains("run the task with --operator"));
}

#[test]
fn a_question_without_an_operator_is_refused_before_motion() {
    let said = refused(async |cell: &mut Cell| {
        let [_left, _right] = ready(cell).await?;
        cell.ask(next_motion().rehearsed("yes")).await.map(|_| ())
    });
    assert_eq!(said, "the task asks the operator \"Next motion?\": run the task with --operator");
}

#[test]
fn a_question_without_an_answer_for_rehearsals_ends_the_rehearsal() {
    let (report, texts) = operated(&["yes"], None, async |cell: &mut Cell| {
        cell.ask(next_motion()).await?;
        assert!(!cell.rehearsing());
        Ok(())
    });
    assert_eq!(report.unwrap().outcome, RunOutcome::Completed);
    assert_eq!(texts, ["Next motion? [yes/no]"]);
}

#[test]
fn an_answer_for_rehearsals_that_is_no_choice_is_refused_before_motion() {
    let (report, _) = operated(&["yes"], None, async |cell: &mut Cell| {
        cell.ask(next_motion().rehearsed("perhaps")).await.map(|_| ())
    });
    let said = "question \"Next motion?\": the answer \"perhaps\" for rehearsals is none of its choices, yes, no";
    assert_eq!(report.unwrap_err().to_string(), said);
}

#[test]
fn a_closed_input_is_an_error_that_the_task_can_handle() {
    let (report, texts) = operated(&[], None, async |cell: &mut Cell| {
        let [mut left, _right] = ready(cell).await?;
        cell.end_rehearsal("the test has an operator")?;
        for question in [next_motion(), Question::open("Name?")] {
            let error = cell.ask(question).await.unwrap_err();
            assert_eq!(error.class(), Class::NonFatal);
            assert!(matches!(error, TaskError::Unanswered { error: OperatorError::Closed, .. }), "{error}");
        }
        let error = left.ask(next_motion()).await.unwrap_err();
        assert!(matches!(error, TaskError::Unanswered { error: OperatorError::Closed, .. }), "{error}");
        left.execute(turn(&left, 0.2)).await
    });
    assert_eq!(report.unwrap().outcome, RunOutcome::Completed);
    assert_eq!(texts.last().unwrap(), "Next motion?: the operator's input is closed");
}

#[test]
fn a_robot_holds_by_a_generator_of_class_2_until_the_operator_reacts() {
    let directory = tempfile::tempdir().unwrap();
    let steps = directory.path().join("steps.csv");
    let (report, _) = operated(&["perhaps", "yes"], Some(&steps), async |cell: &mut Cell| {
        let [mut left, right] = ready(cell).await?;
        // The second question comes after the answer to the first, and waits for its own.
        assert_eq!(left.ask(next_motion().rehearsed("yes")).await?, "yes");
        assert_eq!(column(&left).1, 0.0);
        left.execute(turn(&left, 0.2)).await?;
        drop(right);
        Ok(())
    });
    assert_eq!(report.unwrap().outcome, RunOutcome::Completed);
    let steps = fs::read_to_string(steps).unwrap();
    let of_reaction: Vec<_> = steps.lines().filter(|line| line.contains("OperatorReaction")).collect();
    let count = |event: &str| of_reaction.iter().filter(|line| line.contains(event)).count();
    assert!(count("read-sensor") >= 1 && count("tell-sensor") >= 1, "{of_reaction:?}");
    assert_eq!((count("read-effector"), count("read-order")), (0, 0), "{of_reaction:?}");
}

#[test]
fn a_deadline_without_an_answer_ends_the_hold_of_a_robot_and_its_next_question_is_a_new_one() {
    let (link, panel) = OperatorLink::new(100);
    let task = async |cell: &mut Cell| {
        let [mut left, _right] = ready(cell).await?;
        cell.end_rehearsal("the test has an operator")?;
        for _ in 0..2 {
            let error = left.ask(next_motion().within(ms(300))).await.unwrap_err();
            let limit = ms(300);
            assert!(
                matches!(error, TaskError::Unanswered { error: OperatorError::Late { limit: it }, .. } if it == limit)
            );
        }
        // The question is withdrawn with its future, and the robot takes further instructions.
        drop_after(cell.sleep(ms(100)), async { left.ask(Question::open("Name?")).await.map(|_| ()) }).await;
        left.execute(turn(&left, 0.1)).await
    };
    let program = Program::of(task).with_operator(link);
    let options = RunOptions::on(BenchKind::Lockstep);
    let report = crate::run::run(&two_arms(), &options, &Requests::default(), &program, &mut |_| {}).unwrap();
    assert_eq!(report.outcome, RunOutcome::Completed, "{report}");
    let late = "Next motion?: the operator gave no answer within 300ms";
    let asked = "Next motion? [yes/no]";
    let texts: Vec<_> = panel.texts.try_iter().collect();
    assert_eq!(texts, [asked, late, asked, late, "Name?", "Name?: the question is withdrawn"]);
}
