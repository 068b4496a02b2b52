//! Pages that show images in a browser without a network: everything stands in one HTML file.
//!
//! The page's own code is `page.html`, `style.css` and the scripts beside this file. What they show is a
//! JSON header (`PageHeader`) and blobs: byte strings, deflated and in base64, each in a `<script>` element
//! of its own that no browser runs. The page inflates those it needs when it needs them, so that a large
//! world is on the screen before all of its file is read. Blobs stand in the order of their need: coarse
//! images, then the truth, then single pixels.
//!
//! - An image is a pyramid of tiles (`pyramid`); pixels are codes, and a table gives the value of a code.
//! - Diffraction patterns are a page of their own (`cube.rs`, `cube.html`, `cube.js`), a blob for each row of the scan.
//! - Atomic columns are lists by cells of the field, with positions in whole pm (`column_list`).

mod blobs;
mod column_list;
mod cube;
mod header;
mod plain_images;
mod pyramid;
mod stack;
mod stored;
mod world;

pub use cube::CubePage;
pub(crate) use stack::{ImageOfStack, StackPage};
pub use stored::StoredPage;
pub(crate) use world::WorldPage;

use std::path::Path;

use serde::Serialize;

use blobs::Blobs;
use header::PageHeader;

use super::Colormap;
use crate::error::{Error, Result};
use crate::files::atomic_write;
use crate::setting::Setting;

/// What the page's code consists of, in this order.
const SCRIPTS: [&str; 11] = [
    include_str!("data.js"),
    include_str!("shared.js"),
    include_str!("smooth.js"),
    include_str!("tiles.js"),
    include_str!("view.js"),
    include_str!("truth.js"),
    include_str!("overlays.js"),
    include_str!("readout.js"),
    include_str!("profile.js"),
    include_str!("axes.js"),
    include_str!("main.js"),
];
const STYLE: &str = include_str!("style.css");
const TEMPLATE: &str = include_str!("page.html");

/// A finished page.
pub struct Page {
    /// The file's contents.
    pub html: String,
}

/// What a kind of page consists of, besides its header and blobs.
struct PagePart<'a> {
    title: &'a str,
    /// HTML with places for the others.
    template: &'static str,
    styles: &'a [&'static str],
    scripts: &'a [&'static str],
}

impl Page {
    fn new(header: &PageHeader, blobs: &Blobs) -> Result<Self> {
        let part = PagePart {
            title: &header.title,
            template: TEMPLATE,
            styles: &[STYLE],
            scripts: &SCRIPTS,
        };
        Page::of(&part, header, blobs)
    }

    fn of(part: &PagePart<'_>, header: &impl Serialize, blobs: &Blobs) -> Result<Self> {
        let json = serde_json::to_string(header).map_err(|e| {
            Error::invalid(Setting::Page, part.title, format!("cannot be written as JSON: {e}"))
        })?;
        let mut html = String::with_capacity(blobs.bytes() + (1 << 18));
        for text in part.template.split("{{").enumerate() {
            match text {
                (0, text) => html += text,
                (_, text) => {
                    let (name, rest) = text.split_once("}}").unwrap_or(("", text));
                    match name {
                        "title" => html += &escaped(part.title),
                        "style" => part.styles.iter().for_each(|s| html += s),
                        // Within a script only `</` and `<!--` could end or change it.
                        "header" => html += &json.replace('<', "\\u003c"),
                        "scripts" => part.scripts.iter().for_each(|s| html += s),
                        _ => blobs.append_to(&mut html),
                    }
                    html += rest;
                }
            }
        }
        Ok(Page { html })
    }

    /// Writes the page, complete or not at all.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write(&self, path: &Path) -> Result<()> {
        atomic_write::write(path, self.html.as_bytes())
    }
}

/// The colours of all maps, as the page takes them: `rrggbb` after `rrggbb`.
fn colormaps() -> Vec<(&'static str, String)> {
    let text = |map: Colormap| {
        map.table().iter().map(|[r, g, b]| format!("{r:02x}{g:02x}{b:02x}")).collect()
    };
    Colormap::NAMES.into_iter().map(|(name, map)| (name, text(map))).collect()
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn titles_and_headers_cannot_end_their_element() {
        let header = PageHeader { title: "</script><b>&".into(), ..PageHeader::default() };
        let page = Page::new(&header, &Blobs::default()).unwrap();
        assert!(page.html.contains("<title>&lt;/script&gt;&lt;b&gt;&amp;</title>"));
        assert!(page.html.contains(r#""title":"\u003c/script>\u003cb>&""#));
        assert!(!page.html.contains("{{"), "all places are filled");
        let outside = page.html.matches("http").count();
        assert_eq!(outside, page.html.matches("http://www.w3.org/2000/svg").count(), "no network");
    }
}
