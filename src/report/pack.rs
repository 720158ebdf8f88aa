//! Draws a leaf pack: leaves, contact forces and slip as one SVG picture, or as an SVG animation.
//!
//! The picture is to scale. Force arrows and slip bars have their own scales, which the legend gives. The caller decides
//! which states are drawn.

use std::fmt::Write;

use crate::model::leaf_pack::{ContactShape, LeafShape, PackShape, SlipState};

/// Length of a force arrow, in mm of the picture per N.
const ARROW_MM_PER_N: f64 = 0.05;
/// Magnification of the slip bars.
const SLIP_SCALE: f64 = 40.0;
/// Free space around the pack, mm.
const ROOM_MM: f64 = 45.0;
/// Height of the legend below the pack, mm.
const LEGEND_MM: f64 = 62.0;

const STYLE: &str = "text{font:15px system-ui,sans-serif;fill:#3b4248}.leaf{fill:#9fb0bd;stroke:#46535d;stroke-width:.8}\
.clamp{fill:none;stroke:#46535d;stroke-width:3}.eye{fill:#fff;stroke:#46535d;stroke-width:2.5}\
.link{stroke:#46535d;stroke-width:4;stroke-linecap:round;fill:none}.ground{fill:#46535d}\
.force{stroke-width:1.8;fill:none}.slip{stroke:#8e3bb5;stroke-width:2.6;fill:none}\
.push{stroke:#1c71c4;stroke-width:4;fill:none;stroke-linecap:round}.grips{stroke:#1a8f5a}.slips{stroke:#de751a}\
@media(prefers-color-scheme:dark){text{fill:#d5dbdf}.leaf{fill:#60717e;stroke:#c3ced6}.clamp,.eye,.link{stroke:#c3ced6}\
.eye{fill:#14171a}.ground{fill:#c3ced6}}";

/// One state of the pack as SVG text.
pub(crate) fn picture(shape: &PackShape) -> String {
    draw(std::slice::from_ref(shape), 0.0)
}

/// An animation that repeats every `duration_s` seconds. All states belong to one pack. Without states the text is empty.
pub(crate) fn animation(shapes: &[PackShape], duration_s: f64) -> String {
    draw(shapes, duration_s)
}

fn draw(shapes: &[PackShape], duration_s: f64) -> String {
    let mut svg = String::new();
    // Writing into a string cannot fail.
    let _ = write(&mut svg, shapes, duration_s);
    svg
}

fn write(svg: &mut String, shapes: &[PackShape], duration_s: f64) -> std::fmt::Result {
    let Some(first) = shapes.first() else {
        return Ok(());
    };
    let [left, top, width, height] = frame(shapes);
    writeln!(
        svg,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"{left:.1} {top:.1} {width:.1} {height:.1}\" \
         role=\"img\" aria-label=\"Leaf pack with contact forces and slip\"><style>{STYLE}</style>"
    )?;
    let mut moving = Moving {
        svg,
        shapes,
        duration_s,
    };
    if first.pivot_mm.is_some() {
        moving.path("link", shackle)?;
    } else {
        let y = first.eyes_mm[0][1] + 11.0;
        let (a, b) = (left + 8.0, left + width - 8.0);
        writeln!(
            moving.svg,
            "<path class=\"ground\" d=\"M{a:.1} {y:.1}H{b:.1}v3H{a:.1}z\"/>"
        )?;
    }
    for leaf in 0..first.leaves.len() {
        moving.path("leaf", |s| outline(&s.leaves[leaf]))?;
    }
    moving.path("clamp", clamp)?;
    for eye in 0..2 {
        moving.path("link", |s| eye_arm(s, eye))?;
        moving.path("eye", |s| circle(s.eyes_mm[eye], 8.0))?;
    }
    if let Some(pivot) = first.pivot_mm {
        moving.path("ground", |_| circle(pivot, 5.0))?;
    }
    for contact in 0..first.contacts.len() {
        moving.contact(contact)?;
        moving.path("slip", |s| slip_bar(&s.contacts[contact]))?;
    }
    moving.path("push", pusher)?;
    legend(svg, shapes, [left, top, width, height])?;
    svg.push_str("</svg>\n");
    Ok(())
}

/// Writes the elements that change from state to state.
struct Moving<'a> {
    svg: &'a mut String,
    shapes: &'a [PackShape],
    duration_s: f64,
}

impl Moving<'_> {
    fn path(&mut self, class: &str, d: impl Fn(&PackShape) -> String) -> std::fmt::Result {
        self.coloured(class, d, None::<fn(&PackShape) -> &'static str>)
    }

    /// The normal force between two leaves: green where the contact sticks, orange where it slips.
    fn contact(&mut self, i: usize) -> std::fmt::Result {
        let class = |s: &PackShape| match s.contacts[i].state {
            SlipState::SlipUp | SlipState::SlipDown | SlipState::Smooth => "force slips",
            SlipState::Stick | SlipState::Free => "force grips",
        };
        self.coloured("", |s| arrow(&s.contacts[i]), Some(class))
    }

    fn coloured(
        &mut self,
        class: &str,
        d: impl Fn(&PackShape) -> String,
        class_of: Option<impl Fn(&PackShape) -> &'static str>,
    ) -> std::fmt::Result {
        let Some(first) = self.shapes.first() else {
            return Ok(());
        };
        let class_now = class_of.as_ref().map_or(class, |c| c(first));
        write!(self.svg, "<path class=\"{class_now}\" d=\"{}\"", d(first))?;
        if self.shapes.len() < 2 {
            return self.svg.write_str("/>\n");
        }
        self.svg.write_str(">")?;
        self.animate("d", "linear", &d)?;
        if let Some(class_of) = class_of {
            self.animate("class", "discrete", |s| class_of(s).to_owned())?;
        }
        self.svg.write_str("</path>\n")
    }

    fn animate(
        &mut self,
        attribute: &str,
        mode: &str,
        value: impl Fn(&PackShape) -> String,
    ) -> std::fmt::Result {
        let values: Vec<String> = self.shapes.iter().map(value).collect();
        if values.windows(2).all(|w| w[0] == w[1]) {
            return Ok(());
        }
        write!(
            self.svg,
            "<animate attributeName=\"{attribute}\" calcMode=\"{mode}\" dur=\"{:.2}s\" repeatCount=\"indefinite\" values=\"{}\"/>",
            self.duration_s,
            values.join(";")
        )
    }
}

/// Left, top, width and height of the picture, mm: it holds every state and the legend.
fn frame(shapes: &[PackShape]) -> [f64; 4] {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let mut hold = |x: f64, y: f64| {
        (low[0], low[1]) = (low[0].min(x), low[1].min(y));
        (high[0], high[1]) = (high[0].max(x), high[1].max(y));
    };
    for shape in shapes {
        let stations = shape.leaves.iter().flat_map(|l| &l.stations);
        stations.for_each(|s| hold(s.x_mm, s.y_mm));
        shape
            .pivot_mm
            .iter()
            .chain(&shape.eyes_mm)
            .for_each(|p| hold(p[0], p[1]));
        hold(shape.clamp_mm[1], shape.clamp_mm[0] - pusher_mm(shape) - 25.0);
    }
    let size = [0, 1].map(|i| high[i] - low[i] + 2.0 * ROOM_MM);
    [low[0] - ROOM_MM, low[1] - ROOM_MM, size[0], size[1] + LEGEND_MM]
}

/// The outline of a leaf: its upper and its lower face.
fn outline(leaf: &LeafShape) -> String {
    let half = 0.5 * leaf.thickness_mm;
    let face = |sense: f64| {
        leaf.stations.iter().map(move |s| {
            let (sin, cos) = s.angle_rad.sin_cos();
            (s.x_mm - sense * half * sin, s.y_mm + sense * half * cos)
        })
    };
    let mut d = String::new();
    for (i, (x, y)) in face(1.0).chain(face(-1.0).rev()).enumerate() {
        let _ = write!(d, "{}{x:.2} {y:.2}", if i == 0 { 'M' } else { 'L' });
    }
    d.push('Z');
    d
}

/// Height of the upper and the lower face of the clamped leaves. Leaf 1 is the lowest leaf.
fn faces(shape: &PackShape) -> (f64, f64) {
    let first = shape.leaves.first().map_or(0.0, |l| l.thickness_mm);
    let total: f64 = shape.leaves.iter().map(|l| l.thickness_mm).sum();
    let low = shape.clamp_mm[0] + 0.5 * first;
    (low - total, low)
}

fn clamp(shape: &PackShape) -> String {
    let x = shape.clamp_mm[1];
    let half = shape.clamp_half_mm;
    let (top, low) = faces(shape);
    format!(
        "M{:.2} {:.2}V{:.2}H{:.2}V{:.2}",
        x - half,
        low + 5.0,
        top - 4.0,
        x + half,
        low + 5.0
    )
}

/// The line from the eye's pin to the end of leaf 1.
fn eye_arm(shape: &PackShape, eye: usize) -> String {
    let [x, y] = shape.eyes_mm[eye];
    let stations = shape.leaves.first().map_or(&[][..], |l| &l.stations);
    let end = if eye == 0 {
        stations.first()
    } else {
        stations.last()
    };
    end.map_or(String::new(), |end| {
        format!("M{x:.2} {y:.2}L{:.2} {:.2}", end.x_mm, end.y_mm)
    })
}

fn circle([x, y]: [f64; 2], r: f64) -> String {
    format!(
        "M{:.2} {y:.2}a{r} {r} 0 1 0 {} 0a{r} {r} 0 1 0 -{} 0z",
        x - r,
        2.0 * r,
        2.0 * r
    )
}

fn shackle(shape: &PackShape) -> String {
    let pivot = shape.pivot_mm.unwrap_or(shape.eyes_mm[1]);
    let far = |e: &[f64; 2]| (e[0] - pivot[0]).hypot(e[1] - pivot[1]);
    let [a, b] = &shape.eyes_mm;
    let eye = if far(a) < far(b) { a } else { b };
    format!("M{:.2} {:.2}L{:.2} {:.2}", eye[0], eye[1], pivot[0], pivot[1])
}

fn arrow(contact: &ContactShape) -> String {
    let half = 0.5 * ARROW_MM_PER_N * contact.normal_n;
    format!(
        "M{:.2} {:.2}v{:.2}",
        contact.x_mm,
        contact.y_mm - half,
        2.0 * half
    )
}

fn slip_bar(contact: &ContactShape) -> String {
    let outward = contact.x_mm.signum();
    let length = outward * SLIP_SCALE * contact.slip_mm;
    format!("M{:.2} {:.2}h{length:.2}", contact.x_mm, contact.y_mm)
}

fn pusher_mm(shape: &PackShape) -> f64 {
    ARROW_MM_PER_N * shape.pusher[1].max(0.0)
}

fn pusher(shape: &PackShape) -> String {
    let x = shape.clamp_mm[1];
    let (tip, length) = (faces(shape).0 - 7.0, pusher_mm(shape));
    format!("M{x:.2} {:.2}V{tip:.2}l-5 -8m5 8l5 -8", tip - length - 9.0)
}

fn legend(svg: &mut String, shapes: &[PackShape], [left, top, width, height]: [f64; 4]) -> std::fmt::Result {
    let (x, y) = (left + 12.0, top + height - LEGEND_MM + 16.0);
    let pushers = || shapes.iter().map(|s| s.pusher);
    let (low, high) = (
        pushers().fold([f64::INFINITY; 2], |m, p| [m[0].min(p[0]), m[1].min(p[1])]),
        pushers().fold([f64::NEG_INFINITY; 2], |m, p| [m[0].max(p[0]), m[1].max(p[1])]),
    );
    let what = if shapes.len() > 1 {
        format!(
            "pusher {:.1} to {:.1} mm, {:.0} to {:.0} N",
            low[0], high[0], low[1], high[1]
        )
    } else {
        format!("pusher {:.1} mm, {:.0} N", high[0], high[1])
    };
    writeln!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\">{what}</text>")?;
    let entries = [
        (
            "push",
            format!("pusher force, {:.0} N per cm", 10.0 / ARROW_MM_PER_N),
        ),
        ("force grips", "contact force, sticking".to_owned()),
        ("force slips", "slipping".to_owned()),
        ("slip", format!("slip since assembly, x {SLIP_SCALE:.0}")),
    ];
    let each = (width - 24.0) / entries.len() as f64;
    for (i, (class, text)) in entries.into_iter().enumerate() {
        let x = x + each * i as f64;
        let y = y + 26.0;
        writeln!(
            svg,
            "<path class=\"{class}\" d=\"M{x:.1} {:.1}h18\"/><text x=\"{:.1}\" y=\"{y:.1}\">{text}</text>",
            y - 5.0,
            x + 24.0
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Plant;
    use crate::model::leaf_pack::{LeafPack, Mounting, PackStructure, Values};

    fn shapes(mounting: Mounting) -> Vec<PackShape> {
        let structure = PackStructure {
            mounting,
            ..PackStructure::default()
        };
        let values = Values {
            interleaf_mu: 0.2,
            ..Values::frictionless()
        };
        let mut pack = LeafPack::new(&structure, &values).expect("valid");
        (0..4)
            .map(|k| {
                pack.step(4.0 * f64::from(k), 1.0);
                pack.shape()
            })
            .collect()
    }

    #[test]
    fn a_picture_has_every_leaf_and_contact_and_no_animation() {
        let shapes = shapes(Mounting::Rail);
        let svg = picture(&shapes[3]);
        assert_eq!(svg.matches("class=\"leaf\"").count(), 4);
        // The legend has one more slip bar.
        assert_eq!(
            svg.matches("class=\"slip\"").count(),
            shapes[3].contacts.len() + 1
        );
        assert!(!svg.contains("<animate") && !svg.contains("NaN"));
    }

    #[test]
    fn an_animation_moves_every_leaf_through_every_state_without_script() {
        let svg = animation(&shapes(Mounting::Shackle), 2.0);
        let leaf = svg
            .lines()
            .find(|l| l.contains("class=\"leaf\""))
            .expect("leaves");
        let values = leaf.split("values=\"").nth(1).expect("moves");
        assert_eq!(values.matches('M').count(), 4);
        assert!(svg.contains("class=\"link\"") && !svg.contains("<script") && !svg.contains("NaN"));
    }
}
