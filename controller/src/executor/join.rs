//! Parts of a task that run at the same time.

use std::future::poll_fn;
use std::pin::Pin;
use std::task::Poll;

use super::Agents;

/// A task, or a part of a task.
pub(super) type Part<'a, E> = Pin<Box<dyn Future<Output = Result<(), E>> + 'a>>;

/// Executes two parts of a task at the same time. See [`join_all`].
pub async fn join<E>(
    one: impl Future<Output = Result<(), E>>,
    other: impl Future<Output = Result<(), E>>,
) -> Result<(), E> {
    let parts: [Part<E>; 2] = [Box::pin(one), Box::pin(other)];
    join_all(parts).await
}

/// Executes parts of a task at the same time, polled in their order. Succeeds when all parts have succeeded.
///
/// When one part fails, the other parts are dropped, and their effectors brake. `join_all` returns the error after the
/// standstill of these effectors.
pub async fn join_all<F, E>(parts: impl IntoIterator<Item = F>) -> Result<(), E>
where
    F: Future<Output = Result<(), E>>,
{
    let mut parts: Vec<_> = parts.into_iter().map(Box::pin).map(Some).collect();
    let joined = poll_fn(|context| {
        let mut all_ended = true;
        for part in &mut parts {
            match part.as_mut().map(|future| future.as_mut().poll(context)) {
                Some(Poll::Ready(Ok(()))) => *part = None,
                Some(Poll::Ready(Err(error))) => return Poll::Ready(Err(error)),
                Some(Poll::Pending) => all_ended = false,
                None => {}
            }
        }
        if all_ended { Poll::Ready(Ok(())) } else { Poll::Pending }
    });
    let joined = joined.await;
    if joined.is_err() {
        drop(parts);
        if let Some(agents) = Agents::current() {
            agents.rest().await;
        }
    }
    joined
}
