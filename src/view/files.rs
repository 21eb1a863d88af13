//! The files of the page.

/// A file of the page.
#[derive(Debug)]
pub(crate) struct PageFile {
    /// Path in the address.
    pub(crate) path: &'static str,
    /// Value of `Content-Type`.
    pub(crate) media_type: &'static str,
    /// Content.
    pub(crate) bytes: &'static [u8],
}

/// Files by their path in the address, their type and their name in `page`.
macro_rules! files {
    ($($path:literal $media_type:literal $name:literal;)*) => {
        &[$(PageFile { path: $path, media_type: $media_type, bytes: include_bytes!(concat!("page/", $name)) }),*]
    };
}

/// Every file that needs no token.
pub(crate) const FILES: &[PageFile] = files! {
    "/" "text/html; charset=utf-8" "index.html";
    "/view.js" "text/javascript; charset=utf-8" "view.js";
    "/charts.js" "text/javascript; charset=utf-8" "charts.js";
    "/play.js" "text/javascript; charset=utf-8" "play.js";
    "/pen.js" "text/javascript; charset=utf-8" "pen.js";
    "/records.js" "text/javascript; charset=utf-8" "records.js";
    "/scene.js" "text/javascript; charset=utf-8" "scene.js";
    "/view.css" "text/css; charset=utf-8" "view.css";
    "/uplot.js" "text/javascript; charset=utf-8" "uplot.js";
    "/uplot.css" "text/css; charset=utf-8" "uplot.css";
    "/favicon.svg" "image/svg+xml" "favicon.svg";
};
