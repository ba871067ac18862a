//! What the clients of a hub want of one stage's states, and for a while what those wanted who have just left.
//!
//! A page that is loaded anew finds everything as it was; who comes and goes all the time asks the stage for nothing more.

use std::time::Duration;

use tokio::sync::watch;

use posed_protocol::{Topic, Wish};

/// Time between two looks at who has left: what nobody wants any more is given up after one to two of them.
pub(super) const GRACE: Duration = Duration::from_secs(2);

/// See the module.
pub(super) struct Demand {
    /// What is asked for, for who asks the stage.
    asked: watch::Sender<Wish>,
    wanted: Wish,
    /// All that was wanted since the last look.
    recent: Wish,
}

impl Demand {
    /// Nobody wants anything yet.
    pub(super) fn new(asked: watch::Sender<Wish>) -> Self {
        Self { asked, wanted: Wish::default(), recent: Wish::default() }
    }

    /// Clients want this now: what is more is asked for at once.
    pub(super) fn want(&mut self, wanted: Wish) {
        if wanted == self.wanted {
            return;
        }
        self.recent.join(&wanted);
        self.wanted = wanted;
        let mut more = self.asked.borrow().clone();
        more.join(&self.wanted);
        self.ask(more);
    }

    /// Gives up what nobody has wanted since the last look but one, and says which topics those are.
    pub(super) fn look(&mut self) -> Vec<Topic> {
        let recent = std::mem::replace(&mut self.recent, self.wanted.clone());
        let before = self.asked.borrow().clone();
        let given_up =
            Topic::ALL.into_iter().filter(|topic| before.has(*topic) && !recent.has(*topic)).collect();
        self.ask(recent);
        given_up
    }

    /// Whether states of a topic are asked for.
    pub(super) fn has(&self, topic: Topic) -> bool {
        self.asked.borrow().has(topic)
    }

    fn ask(&self, wish: Wish) {
        self.asked.send_if_modified(|asked| {
            *asked != wish && {
                *asked = wish;
                true
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_is_asked_for_at_once_and_less_after_a_while() {
        let (asked, asked_for) = watch::channel(Wish::default());
        let mut demand = Demand::new(asked);
        let of = |rates_hz: &[f64]| {
            let mut wish = Wish::default();
            rates_hz.iter().for_each(|rate_hz| wish.add(Topic::Sensors, Some(*rate_hz)));
            wish
        };
        let rate_hz = || asked_for.borrow().max_rate_hz(Topic::Sensors);
        demand.want(of(&[20.0]));
        demand.want(of(&[20.0, 60.0]));
        assert_eq!(rate_hz(), Some(60.0));
        demand.look();
        demand.want(of(&[20.0]));
        assert_eq!((demand.look(), rate_hz()), (vec![], Some(60.0)), "it was wanted a moment ago");
        assert_eq!((demand.look(), rate_hz()), (vec![], Some(20.0)));
        demand.want(of(&[]));
        // A page that is loaded anew, again and again.
        for _ in 0..5 {
            demand.look();
            demand.want(of(&[20.0]));
            demand.want(of(&[]));
            assert!(demand.has(Topic::Sensors));
        }
        demand.look();
        assert_eq!(demand.look(), [Topic::Sensors]);
        assert!(asked_for.borrow().is_empty());
        assert_eq!(demand.look(), []);
    }
}
