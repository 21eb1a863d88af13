//! The sheet of paper: lines, letters and arrows in tenths of a millimetre, from the upper left corner.
//!
//! This module uses the plotting crate's primitives and its two back ends, not its plots. The crate's plots support neither panels of equal
//! aspect beside panels over time. Dashes are cut here, because the PNG back end begins the pattern anew at every corner
//! and does not scale it. Nothing is written upward: that back end renders turned letters without smooth edges, as if they were bold. The
//! names of upright axes stand above them.

use super::Error;
use super::curve::{Frame, Point, dashes};
use kuva::RasterBackend;
use kuva::backend::svg::SvgBackend;
use kuva::render::color::Color as Paint;
use kuva::render::render::{PathData, Primitive, Scene, TextAnchor, TextSpan};
use kuva::render::render_utils::arrow_head_path;
use yieldwall_motion::elementary;

/// Width of every figure: 160 mm.
pub(super) const WIDTH: f64 = 1600.0;
/// Height of all letters: 2.8 mm, 7.9 pt.
pub(super) const LETTER: u32 = 28;

/// Width of an oblique "R" and of a space, in parts of the letter height, by the font's own tables.
const WIDTH_OF_R: f64 = 0.70;
const WIDTH_OF_SPACE: f64 = 0.32;
/// Named first so that a viewer takes the embedded font; the second has the same widths.
const FONTS: &str = "DejaVu Sans, Verdana, sans-serif";
const PICTURE_WIDTHS_PX: std::ops::RangeInclusive<u32> = 100..=20_000;

/// Red, green, blue.
#[derive(Clone, Copy, Debug)]
pub(super) struct Color(pub u8, pub u8, pub u8);

impl From<Color> for Paint {
    fn from(Color(red, green, blue): Color) -> Self {
        Self::Rgb(red, green, blue)
    }
}

pub(super) const BLACK: Color = Color(0, 0, 0);
pub(super) const WHITE: Color = Color(0xff, 0xff, 0xff);
pub(super) const GREY: Color = Color(0x70, 0x70, 0x70);
pub(super) const PALE: Color = Color(0xd4, 0xd4, 0xd4);
/// Light blue and dark vermilion of a palette that colour-blind readers can distinguish; also far apart in lightness.
pub(super) const SKY: Color = Color(0x56, 0xb4, 0xe9);
pub(super) const VERMILION: Color = Color(0xa8, 0x32, 0x00);

/// Style of a line. `dash` holds the lengths of strokes and gaps in turn; empty: a full line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stroke {
    pub color: Color,
    pub width: f64,
    pub dash: &'static [f64],
}

/// Position of a text relative to its point.
#[derive(Clone, Copy, Debug)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

impl From<Anchor> for TextAnchor {
    fn from(anchor: Anchor) -> Self {
        match anchor {
            Anchor::Start => Self::Start,
            Anchor::Middle => Self::Middle,
            Anchor::End => Self::End,
        }
    }
}

#[derive(Debug)]
pub(super) struct Page {
    scene: Scene,
}

impl Page {
    pub(super) fn new(height: f64) -> Self {
        let mut scene = Scene::new(WIDTH, height.ceil());
        scene.font_family = Some(FONTS.to_owned());
        Self { scene }
    }

    /// Draws what `draw` draws, cut to a frame: the ends of wide lines do not stand over it.
    pub(super) fn within(&mut self, Frame { left, top, right, bottom }: Frame, draw: impl FnOnce(&mut Self)) {
        let (width, height) = (right - left, bottom - top);
        let id = format!("frame{}", self.scene.defs.len());
        // The SVG back end takes the rectangle from here, the PNG back end from the primitive.
        self.scene.defs.push(format!(
            r#"<clipPath id="{id}"><rect x="{left}" y="{top}" width="{width}" height="{height}"/></clipPath>"#
        ));
        self.scene.elements.push(Primitive::ClipStart { x: left, y: top, width, height, id });
        draw(self);
        self.scene.elements.push(Primitive::ClipEnd);
    }

    /// Draws a chain of straight lines.
    pub(super) fn chain(&mut self, points: &[Point], stroke: Stroke) {
        for points in dashes(points, stroke.dash) {
            self.scene.elements.push(Primitive::PolyLine {
                points,
                stroke: stroke.color.into(),
                stroke_width: stroke.width,
                stroke_dasharray: None,
            });
        }
    }

    pub(super) fn dot(&mut self, point: Point, radius: f64, color: Color) {
        self.ring(point, radius, color, Stroke { color, width: 0.0, dash: &[] });
    }

    /// Draws a circle.
    pub(super) fn ring(&mut self, (x, y): Point, radius: f64, fill: Color, line: Stroke) {
        self.scene.elements.push(Primitive::Circle {
            cx: x,
            cy: y,
            r: radius,
            fill: fill.into(),
            fill_opacity: None,
            stroke: (line.width > 0.0).then(|| line.color.into()),
            stroke_width: (line.width > 0.0).then_some(line.width),
        });
    }

    /// Draws a closed shape.
    pub(super) fn shape(&mut self, corners: &[Point], fill: Color, line: Stroke) {
        let corner = |(at, (x, y)): (usize, &Point)| format!("{}{x:.2},{y:.2}", if at == 0 { "M" } else { "L" });
        let corners: String = corners.iter().enumerate().map(corner).collect();
        self.scene.elements.push(Primitive::Path(Box::new(PathData {
            d: corners + "Z",
            fill: Some(fill.into()),
            stroke: line.color.into(),
            stroke_width: line.width,
            opacity: None,
            stroke_dasharray: None,
        })));
    }

    /// Draws an arrow; its head shrinks with arrows too short for it.
    pub(super) fn arrow(&mut self, from: Point, to: Point, color: Color, width: f64) {
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let length = elementary::hypot(dx, dy);
        if length == 0.0 {
            return;
        }
        let (along, across) = (dx / length, dy / length);
        let head = (5.0 * width).min(0.6 * length);
        let neck = (to.0 - 0.8 * head * along, to.1 - 0.8 * head * across);
        self.chain(&[from, neck], Stroke { color, width, dash: &[] });
        self.scene.elements.push(Primitive::Path(Box::new(PathData {
            d: arrow_head_path(to.0, to.1, along, across, head, 0.36 * head),
            fill: Some(color.into()),
            stroke: Paint::None,
            stroke_width: 0.0,
            opacity: None,
            stroke_dasharray: None,
        })));
    }

    /// Draws a patch of paper colour under a text.
    pub(super) fn blank(&mut self, (x, y): Point, width: f64, height: f64) {
        self.scene.elements.push(Primitive::Rect {
            x: x - width / 2.0,
            y: y - height / 2.0,
            width,
            height,
            fill: Paint::Rgb(255, 255, 255),
            stroke: None,
            stroke_width: None,
            opacity: Some(0.8),
        });
    }

    pub(super) fn bold_text(&mut self, point: Point, content: &str) {
        self.styled_text(point, content, true, false);
    }

    pub(super) fn slanted_text(&mut self, point: Point, content: &str) {
        self.styled_text(point, content, false, true);
    }

    /// Draws a slanted letter, with a word that may be empty.
    pub(super) fn symbol(&mut self, (x, y): Point, letter: &str, word: &str) {
        self.slanted_text((x, y), letter);
        if !word.is_empty() {
            self.text((x + (WIDTH_OF_R + WIDTH_OF_SPACE) * f64::from(LETTER), y), Anchor::Start, word);
        }
    }

    /// Draws a text whose base line passes through the point.
    pub(super) fn text(&mut self, (x, y): Point, anchor: Anchor, content: &str) {
        self.scene.elements.push(Primitive::Text {
            x,
            y,
            content: literal(content),
            size: LETTER,
            anchor: anchor.into(),
            rotate: None,
            bold: false,
            color: Some(BLACK.into()),
        });
    }

    fn styled_text(&mut self, (x, y): Point, content: &str, bold: bool, italic: bool) {
        let text = content.to_owned();
        self.scene.elements.push(Primitive::RichText {
            x,
            y,
            spans: vec![TextSpan { text, bold, italic, underline: false, code: false, math: false }],
            size: LETTER,
            anchor: TextAnchor::Start,
            color: Some(BLACK.into()),
        });
    }

    /// Returns the sheet as SVG. The back end counts in pixels and leaves corners pointed, which draws noise as a
    /// thick bar; the head is rewritten to millimetres and round corners.
    pub(super) fn svg(&self, is_font_embedded: bool) -> String {
        let svg = SvgBackend::new().with_embedded_font(is_font_embedded).render_scene(&self.scene);
        let (width, height) = (self.scene.width, self.scene.height);
        let counted = format!(r#"width="{width}" height="{height}""#);
        let measured = format!(
            r#"width="{}mm" height="{}mm" viewBox="0 0 {width} {height}" stroke-linejoin="round""#,
            width / 10.0,
            height / 10.0
        );
        svg.replacen(&counted, &measured, 1)
    }

    /// Returns the sheet as PNG.
    pub(super) fn png(&self, width_px: u32) -> Result<Vec<u8>, Error> {
        if !PICTURE_WIDTHS_PX.contains(&width_px) {
            return Err(Error::PictureWidth { width_px });
        }
        let scale = (f64::from(width_px) / WIDTH) as f32;
        RasterBackend::new().with_scale(scale).render_scene(&self.scene).map_err(|reason| Error::Encode { reason })
    }
}

/// Escapes each dollar sign, since the crate reads `$..$` as mathematics.
fn literal(content: &str) -> String {
    content.replace('$', "\\$")
}
