//! Files of DigitalMicrograph, written from the descriptions of the format (C. B. Boothroyd; G. Jefferis).
//!
//! Each test uses a part of this.
#![allow(dead_code)]

/// A tag.
#[derive(Clone)]
pub enum Dm {
    Group(Vec<(&'static str, Dm)>),
    Float(f32),
    Double(f64),
    Long(u32),
    Text(&'static str),
    /// Code of the numbers, how many, and their bytes in the order of the file.
    Array(u64, u64, Vec<u8>),
    /// Two doubles.
    Record([f64; 2]),
}

/// How a file is written.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DmStyle {
    pub version: u32,
    pub little: bool,
}

pub const DM3: DmStyle = DmStyle { version: 3, little: true };
pub const DM4: DmStyle = DmStyle { version: 4, little: true };
pub const DM3_BIG: DmStyle = DmStyle { version: 3, little: false };

impl DmStyle {
    /// A length: 4 bytes in version 3, 8 in version 4; always the greater bytes first.
    fn size(self, value: u64) -> Vec<u8> {
        match self.version {
            3 => (value as u32).to_be_bytes().to_vec(),
            _ => value.to_be_bytes().to_vec(),
        }
    }

    /// A number, given with its smaller bytes first.
    pub fn value(self, mut little: Vec<u8>) -> Vec<u8> {
        if !self.little {
            little.reverse();
        }
        little
    }

    /// A file of these tags.
    pub fn file(self, tags: Vec<(&'static str, Dm)>) -> Vec<u8> {
        let body = self.group(&tags);
        let mut out = self.version.to_be_bytes().to_vec();
        out.extend(self.size(body.len() as u64));
        out.extend(u32::from(self.little).to_be_bytes());
        out.extend(body);
        out.extend([0; 8]);
        out
    }

    fn group(self, tags: &[(&'static str, Dm)]) -> Vec<u8> {
        let mut out = vec![1, 0];
        out.extend(self.size(tags.len() as u64));
        for (name, tag) in tags {
            let content = match tag {
                Dm::Group(tags) => self.group(tags),
                other => self.data(other),
            };
            out.push(if matches!(tag, Dm::Group(_)) { 20 } else { 21 });
            out.extend((name.len() as u16).to_be_bytes());
            out.extend(name.as_bytes());
            if self.version == 4 {
                out.extend(self.size(content.len() as u64));
            }
            out.extend(content);
        }
        out
    }

    fn data(self, tag: &Dm) -> Vec<u8> {
        let (kind, bytes): (Vec<u64>, Vec<u8>) = match tag {
            Dm::Float(v) => (vec![6], self.value(v.to_le_bytes().to_vec())),
            Dm::Double(v) => (vec![7], self.value(v.to_le_bytes().to_vec())),
            Dm::Long(v) => (vec![5], self.value(v.to_le_bytes().to_vec())),
            Dm::Text(text) => {
                let letters: Vec<u16> = text.encode_utf16().collect();
                let bytes = letters.iter().flat_map(|l| self.value(l.to_le_bytes().to_vec()));
                (vec![20, 4, letters.len() as u64], bytes.collect())
            }
            Dm::Array(code, count, bytes) => (vec![20, *code, *count], bytes.clone()),
            Dm::Record(values) => {
                let bytes = values.iter().flat_map(|v| self.value(v.to_le_bytes().to_vec()));
                (vec![15, 0, 2, 0, 7, 0, 7], bytes.collect())
            }
            Dm::Group(_) => unreachable!("groups have no values"),
        };
        let mut out = b"%%%%".to_vec();
        out.extend(self.size(kind.len() as u64));
        kind.iter().for_each(|number| out.extend(self.size(*number)));
        out.extend(bytes);
        out
    }
}

/// One entry of the list of images: lengths from the fastest on, kind of the image and of its numbers.
pub fn image(
    name: &'static str,
    lengths: &[u32],
    kind: u32,
    code: u64,
    bytes: Vec<u8>,
    (scale, unit): (f32, &'static str),
) -> Dm {
    let count = lengths.iter().map(|n| u64::from(*n)).product();
    let axis = || {
        Dm::Group(vec![
            ("Origin", Dm::Float(0.0)),
            ("Scale", Dm::Float(scale)),
            ("Units", Dm::Text(unit)),
        ])
    };
    let axes = lengths.iter().map(|_| ("", axis())).collect();
    let lengths = lengths.iter().map(|n| ("", Dm::Long(*n))).collect();
    Dm::Group(vec![
        (
            "ImageData",
            Dm::Group(vec![
                ("Calibrations", Dm::Group(vec![("Dimension", Dm::Group(axes))])),
                ("Data", Dm::Array(code, count, bytes)),
                ("DataType", Dm::Long(kind)),
                ("Dimensions", Dm::Group(lengths)),
                ("PixelDepth", Dm::Long(4)),
            ]),
        ),
        (
            "ImageTags",
            Dm::Group(vec![("Microscope Info", Dm::Group(vec![("Voltage", Dm::Double(2e5))]))]),
        ),
        ("Name", Dm::Text(name)),
    ])
}

/// The tags of a file with a thumbnail and images.
pub fn document(images: Vec<Dm>) -> Vec<(&'static str, Dm)> {
    let thumbnail = image("", &[2, 2], 23, 5, vec![7; 16], (1.0, ""));
    let list = std::iter::once(thumbnail).chain(images).map(|image| ("", image)).collect();
    vec![
        ("ApplicationBounds", Dm::Record([0.5, 1.5])),
        ("ImageList", Dm::Group(list)),
        ("Thumbnails", Dm::Group(vec![("", Dm::Group(vec![("ImageIndex", Dm::Long(0))]))])),
    ]
}

/// Single precision numbers as bytes of a file.
pub fn floats(style: DmStyle, values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    values.into_iter().flat_map(|v| style.value(v.to_le_bytes().to_vec())).collect()
}
