//! The page's files, as answers.

use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};

/// A file of the page by its path.
pub(super) fn file(path: &str) -> Response {
    match posed_viewer::file(path) {
        Some(file) => ([(header::CONTENT_TYPE, file.kind)], file.data).into_response(),
        None => (StatusCode::NOT_FOUND, "no such file\n").into_response(),
    }
}
