//! Pictures into files.

use std::{
    collections::HashMap,
    io::{BufWriter, Write as _},
    path::Path,
    process::{Child, Command, ExitStatus, Stdio},
};

use anyhow::{Context, Result, ensure};
use color_quant::NeuQuant;
use shield_config::atomic_file::AtomicFile;
use shield_report::{film::overlay_colours, report::Picture};

/// Writes pictures to a file, which appears under its name only when it is complete.
pub struct Encoder {
    // Dropped first: ffmpeg must have ended before its file is removed.
    form: Form,
    /// `None` once a GIF has begun, which owns its file.
    file: Option<AtomicFile>,
    fps: u16,
}

enum Form {
    Gif(Option<Box<Gif>>),
    Png(Option<Picture>),
    Mp4(Option<Ffmpeg>),
}

impl Encoder {
    /// Chooses the form by the file's ending. Err is for the user.
    pub fn create(path: &Path, fps: u16) -> Result<Self, String> {
        let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or("");
        let form = match ending {
            "gif" => Form::Gif(None),
            "png" => Form::Png(None),
            "mp4" => {
                let found = Command::new("ffmpeg").arg("-version").stdout(Stdio::null()).status();
                if found.is_err() {
                    return Err("an .mp4 needs the program ffmpeg, which is not installed (on Debian: apt install ffmpeg); .gif and .png \
                                need nothing"
                        .into());
                }
                Form::Mp4(None)
            }
            _ => return Err(format!("{}: a picture ends in .gif, .png or .mp4", path.display())),
        };
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        if let Some(folder) = folder
            && !folder.is_dir()
        {
            return Err(format!("the folder {} does not exist", folder.display()));
        }
        let file = AtomicFile::create(path).map_err(|error| format!("{}: {error}", path.display()))?;
        Ok(Self { form, file: Some(file), fps })
    }

    /// Adds a picture.
    pub fn add(&mut self, picture: &Picture) -> Result<()> {
        match &mut self.form {
            Form::Png(last) => *last = Some(picture.clone()),
            Form::Gif(gif) => {
                if let Some(file) = self.file.take() {
                    *gif = Some(Box::new(Gif::create(file, picture, self.fps)?));
                }
                gif.as_mut().context("the GIF was just made")?.add(picture)?;
            }
            Form::Mp4(child) => {
                if child.is_none() {
                    let file = self.file.as_ref().context("only a GIF takes the file")?;
                    *child = Some(Ffmpeg::start(file.temporary_path(), picture, self.fps)?);
                }
                child.as_mut().context("ffmpeg was just started")?.add(picture)?;
            }
        }
        Ok(())
    }

    /// Completes the file.
    pub fn finish(mut self) -> Result<()> {
        let file = match &mut self.form {
            Form::Png(last) => {
                let png = last.take().context("nothing was filmed")?.png()?;
                let mut file = self.file.take().context("only a GIF takes the file")?;
                file.write_all(&png)?;
                file
            }
            Form::Gif(gif) => gif.take().context("nothing was filmed")?.finish()?,
            Form::Mp4(child) => {
                let status = child.as_mut().context("nothing was filmed")?.finish()?;
                ensure!(status.success(), "ffmpeg failed ({status})");
                self.file.take().context("only a GIF takes the file")?
            }
        };
        Ok(file.commit()?)
    }
}

/// The program ffmpeg at work; ended when it is dropped.
struct Ffmpeg(Child);

impl Ffmpeg {
    fn start(path: &Path, picture: &Picture, fps: u16) -> Result<Self> {
        let size = format!("{}x{}", picture.width(), picture.height());
        let mut command = Command::new("ffmpeg");
        command.args(["-loglevel", "error", "-y", "-f", "rawvideo", "-pixel_format", "rgb24"]);
        command.args(["-video_size", &size, "-framerate", &fps.to_string(), "-i", "-"]);
        // Its usual colours need even sides.
        command.args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", "-f", "mp4"]);
        let child = command.arg(path).stdin(Stdio::piped()).spawn().context("ffmpeg could not be started")?;
        Ok(Self(child))
    }

    fn add(&mut self, picture: &Picture) -> Result<()> {
        let input = self.0.stdin.as_mut().context("ffmpeg takes no input")?;
        input.write_all(picture.pixels()).context("ffmpeg ended early; what it said stands above")
    }

    /// Waits until it has written everything; closes its input first.
    fn finish(&mut self) -> Result<ExitStatus> {
        self.0.wait().context("ffmpeg was lost")
    }
}

impl Drop for Ffmpeg {
    fn drop(&mut self) {
        // Both fail only where it has ended already.
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// One palette for the whole film, and of each picture only the rectangle that changed: small, and nothing flickers.
struct Gif {
    encoder: gif::Encoder<BufWriter<AtomicFile>>,
    quantiser: NeuQuant,
    known: HashMap<[u8; 3], u8>,
    before: Option<Picture>,
    /// In hundredths of a second.
    delay: u16,
}

impl Gif {
    fn create(file: AtomicFile, first: &Picture, fps: u16) -> Result<Self> {
        /// So often each colour of the overlay counts, which the first picture may not show.
        const WEIGHT: usize = 500;
        let opaque = |pixel: &[u8]| [pixel[0], pixel[1], pixel[2], 255];
        let mut sample: Vec<u8> = first.pixels().chunks_exact(3).flat_map(opaque).collect();
        for colour in overlay_colours() {
            sample.extend(std::iter::repeat_n(opaque(&colour), WEIGHT).flatten());
        }
        let quantiser = NeuQuant::new(3, 256, &sample);
        let (width, height) = (u16::try_from(first.width())?, u16::try_from(first.height())?);
        let mut encoder = gif::Encoder::new(BufWriter::new(file), width, height, &quantiser.color_map_rgb())?;
        encoder.set_repeat(gif::Repeat::Infinite)?;
        Ok(Self { encoder, quantiser, known: HashMap::new(), before: None, delay: 100 / fps })
    }

    fn add(&mut self, picture: &Picture) -> Result<()> {
        let [left, top, width, height] = changed(self.before.as_ref(), picture);
        let mut indices = Vec::with_capacity(width * height);
        for row in top..top + height {
            let start = 3 * (row * picture.width() + left);
            for pixel in picture.pixels()[start..start + 3 * width].as_chunks::<3>().0 {
                let quantiser = &self.quantiser;
                let index = self
                    .known
                    .entry(*pixel)
                    .or_insert_with(|| quantiser.index_of(&[pixel[0], pixel[1], pixel[2], 255]) as u8);
                indices.push(*index);
            }
        }
        self.encoder.write_frame(&gif::Frame {
            delay: self.delay,
            left: left as u16,
            top: top as u16,
            width: width as u16,
            height: height as u16,
            buffer: indices.into(),
            ..gif::Frame::default()
        })?;
        self.before = Some(picture.clone());
        Ok(())
    }

    fn finish(self) -> Result<AtomicFile> {
        let writer = self.encoder.into_inner()?;
        writer.into_inner().map_err(|error| error.into_error()).context("the GIF was not completed")
    }
}

/// The rectangle (left, top, width, height) outside of which nothing changed; at least one pixel.
fn changed(before: Option<&Picture>, now: &Picture) -> [usize; 4] {
    let (width, height) = (now.width(), now.height());
    let Some(before) = before else { return [0, 0, width, height] };
    let [mut left, mut top, mut right, mut bottom] = [width, height, 0, 0];
    let pairs = before.pixels().chunks_exact(3).zip(now.pixels().chunks_exact(3));
    for (index, _) in pairs.enumerate().filter(|(_, (before, now))| before != now) {
        let (x, y) = (index % width, index / width);
        (left, top) = (left.min(x), top.min(y));
        (right, bottom) = (right.max(x + 1), bottom.max(y + 1));
    }
    if right == 0 { [0, 0, 1, 1] } else { [left, top, right - left, bottom - top] }
}
