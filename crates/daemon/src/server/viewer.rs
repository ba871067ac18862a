//! The page's files, as answers.

use std::convert::Infallible;

use axum::body::Body;
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// Names of these have a digest of what they hold: whoever has one need not ask for it again.
const FOR_EVER: &str = "private, max-age=31536000, immutable";

/// How a client takes files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Coding {
    Plain,
    Gzip,
}

impl Coding {
    /// By RFC 9110, 12.5.3: gzip where it is named, with a quality that is not zero.
    fn of(headers: &HeaderMap) -> Self {
        let stated = headers.get_all(header::ACCEPT_ENCODING).iter().filter_map(|value| value.to_str().ok());
        let takes_gzip = stated.flat_map(|value| value.split(',')).any(|coding| {
            let mut parts = coding.split(';').map(str::trim);
            let is_gzip = parts.next().is_some_and(|name| name.eq_ignore_ascii_case("gzip"));
            let quality = parts.find_map(|part| part.strip_prefix("q=")?.parse::<f64>().ok());
            is_gzip && quality.unwrap_or(1.0) > 0.0
        });
        if takes_gzip { Self::Gzip } else { Self::Plain }
    }
}

impl<S: Sync> FromRequestParts<S> for Coding {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _state: &S) -> Result<Self, Infallible> {
        Ok(Self::of(&parts.headers))
    }
}

/// A file of the page by its path.
pub(super) fn file(path: &str, coding: Coding) -> Response {
    let Some(file) = posed_viewer::file(path) else {
        return (StatusCode::NOT_FOUND, "no such file\n").into_response();
    };
    let mut response = Response::new(match coding {
        Coding::Gzip => Body::from(file.gzip),
        Coding::Plain => Body::from(file.plain()),
    });
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(file.kind));
    headers.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
    if coding == Coding::Gzip {
        headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
    }
    if path.starts_with("assets/") {
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static(FOR_EVER));
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gzip_is_for_who_names_it() {
        let coding = |stated: &'static str| {
            Coding::of(&HeaderMap::from_iter([(header::ACCEPT_ENCODING, HeaderValue::from_static(stated))]))
        };
        for stated in
            ["gzip", "GZIP", "gzip, deflate, br", "br;q=1.0, gzip;q=0.8, *;q=0.1", "identity , gzip ; q=1"]
        {
            assert_eq!(coding(stated), Coding::Gzip, "{stated}");
        }
        for stated in ["", "identity", "br", "gzip;q=0", "gzip; q=0.000, br", "x-gzip"] {
            assert_eq!(coding(stated), Coding::Plain, "{stated}");
        }
        assert_eq!(Coding::of(&HeaderMap::new()), Coding::Plain);
    }
}
