//! The distinct choices of fields, sensors and encoding that subscriptions have made.
//!
//! In: views that are wanted, and that are not any more. Out: their places, and the body of a message in each, written once however many
//! share it. A place is taken over once nobody uses it, so that there are never more than the limit.

use std::sync::Arc;

use posed_protocol::View;

/// See the module.
pub(super) struct Views {
    shared: Vec<SharedView>,
    most: usize,
}

/// A view and how many subscriptions use it.
struct SharedView {
    view: View,
    users: usize,
    /// Body of the message being published.
    body: Option<Arc<[u8]>>,
}

impl Views {
    /// None yet, and so many at most.
    pub(super) fn new(most: usize) -> Self {
        Self { shared: Vec::new(), most }
    }

    /// The place of an equal view, or a new one; one more subscription uses it.
    pub(super) fn take(&mut self, view: &View) -> Result<usize, (&'static str, String)> {
        let equal = self.shared.iter().position(|shared| shared.users > 0 && shared.view == *view);
        let place = match equal.or_else(|| self.shared.iter().position(|shared| shared.users == 0)) {
            Some(place) => place,
            None if self.shared.len() < self.most => {
                self.shared.push(SharedView { view: view.clone(), users: 0, body: None });
                self.shared.len() - 1
            }
            None => {
                let message =
                    "too many different choices of sensors and fields are in use: subscribe to all of them";
                return Err(("busy", message.into()));
            }
        };
        let shared = &mut self.shared[place];
        if shared.users == 0 {
            shared.view = view.clone();
        }
        shared.users += 1;
        Ok(place)
    }

    /// One subscription less uses the view of this place.
    pub(super) fn release(&mut self, place: usize) {
        self.shared[place].users -= 1;
    }

    /// The view of a place.
    pub(super) fn get(&self, place: usize) -> &View {
        &self.shared[place].view
    }

    /// The next message begins: no body is written yet.
    pub(super) fn begin(&mut self) {
        self.shared.iter_mut().for_each(|shared| shared.body = None);
    }

    /// The message's body in the view of a place, written for the first who asks.
    pub(super) fn body(&mut self, place: usize, write: impl FnOnce(&View) -> Arc<[u8]>) -> Arc<[u8]> {
        let SharedView { view, body, .. } = &mut self.shared[place];
        Arc::clone(body.get_or_insert_with(|| write(view)))
    }
}
