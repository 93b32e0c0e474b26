//! Who could put another library in the place of one that is about to be loaded: its owner, and everyone who may write to it or to a folder on the way
//! to it.

use std::{
    ffi::OsString,
    fmt,
    fs::{self, Metadata},
    io,
    os::unix::fs::MetadataExt as _,
    path::{Path, PathBuf},
};

use nix::{
    errno::Errno,
    unistd::{Gid, Group, Uid, User},
};

use super::PluginError;

/// Set to 1 to load plugins that others on this machine may have replaced.
pub const ALLOW_WRITABLE: &str = "SHIELD_ALLOW_WRITABLE_PLUGINS";

/// As many links as the system follows on one path.
const MOST_LINKS: u32 = 40;
const STICKY: u32 = 0o1000;
const WRITE_BY_GROUP: u32 = 0o020;
const WRITE_BY_EVERYONE: u32 = 0o002;

/// Why a file, a folder or a link is not trusted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Distrust {
    /// The file, folder or link.
    pub place: PathBuf,
    /// Who could change what lies there.
    pub by: Stranger,
    is_link: bool,
    /// The user of this program.
    user: u32,
}

/// Who could change a plugin and is not trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stranger {
    /// The owner, by their user number.
    Owner(u32),
    /// The members of a group, by its number.
    Group(u32),
    /// Every user of the machine.
    Everyone,
}

impl fmt::Display for Distrust {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let place = self.place.display();
        match self.by {
            Stranger::Owner(owner) => {
                write!(formatter, "{place} belongs to user {owner}, who could decide what runs here; ")?;
                let options = if self.is_link { "-h " } else { "" };
                write!(formatter, "take it over (`chown {options}{} {place}`)", self.user)
            }
            Stranger::Group(group) => write!(
                formatter,
                "{place} is writable by group {group}, which could decide what runs here; take that right away \
                 (`chmod g-w {place}`)"
            ),
            Stranger::Everyone => write!(
                formatter,
                "{place} is writable by every user of this machine, so that anyone could decide what runs here; take that right \
                 away (`chmod o-w {place}`)"
            ),
        }
    }
}

/// Refuses a library that anyone but root and the user of this program could replace. Everything that leads to it is checked: the path as it is
/// given, with its parents up to the root, each link, and what the link leads to.
pub(super) fn check_trust(path: &Path) -> Result<(), PluginError> {
    if std::env::var_os(ALLOW_WRITABLE).is_some_and(|value| value == "1") {
        return Ok(());
    }
    match first_distrust(path, Uid::effective()) {
        Ok(None) => Ok(()),
        Ok(Some(distrust)) => Err(PluginError::Untrusted { path: path.into(), distrust }),
        Err(error) => Err(PluginError::Unreadable { path: path.into(), reason: error.to_string() }),
    }
}

/// Goes to `path` as the system does, from the root on.
fn first_distrust(path: &Path, user: Uid) -> io::Result<Option<Distrust>> {
    let (mut reached, mut links) = (PathBuf::new(), 0);
    let mut rest = backwards(&std::path::absolute(path)?);
    while let Some(part) = rest.pop() {
        if part == ".." {
            reached.pop();
            continue;
        }
        // A path that begins at the root replaces what was reached.
        let place = reached.join(&part);
        let data = fs::symlink_metadata(&place)?;
        if let Some(by) = stranger(&data, user) {
            let is_link = data.is_symlink();
            return Ok(Some(Distrust { place, by, is_link, user: user.as_raw() }));
        }
        if data.is_symlink() {
            links += 1;
            if links > MOST_LINKS {
                return Err(Errno::ELOOP.into());
            }
            rest.extend(backwards(&fs::read_link(&place)?));
        } else {
            reached = place;
        }
    }
    Ok(None)
}

/// The parts of a path; the first is the last.
fn backwards(path: &Path) -> Vec<OsString> {
    path.components().rev().map(|part| part.as_os_str().to_owned()).collect()
}

fn stranger(data: &Metadata, user: Uid) -> Option<Stranger> {
    if !is_trusted(Uid::from_raw(data.uid()), user) {
        return Some(Stranger::Owner(data.uid()));
    }
    // The mode of a link has no meaning. In a sticky folder such as /tmp, only the owner of an entry can replace it, and the entry is checked next.
    if data.is_symlink() || data.is_dir() && data.mode() & STICKY != 0 {
        return None;
    }
    if data.mode() & WRITE_BY_EVERYONE != 0 {
        return Some(Stranger::Everyone);
    }
    let is_open = data.mode() & WRITE_BY_GROUP != 0 && !is_private(Gid::from_raw(data.gid()), user);
    is_open.then(|| Stranger::Group(data.gid()))
}

fn is_trusted(owner: Uid, user: Uid) -> bool {
    owner.is_root() || owner == user
}

/// Whether a group has no other member than the user or root. A group that cannot be looked up has.
fn is_private(group: Gid, user: Uid) -> bool {
    let trusted: Vec<User> =
        [user, Uid::from_raw(0)].into_iter().filter_map(|user| User::from_uid(user).ok().flatten()).collect();
    Group::from_gid(group).ok().flatten().is_some_and(|group| is_private_group_of(&group, &trusted))
}

/// Debian, Ubuntu, Fedora and others give each user a group of the same name, and with it the umask 002. It is the rule by which they choose that
/// umask, and the group must list no one else.
fn is_private_group_of(group: &Group, trusted: &[User]) -> bool {
    trusted.iter().any(|user| user.gid == group.gid && user.name == group.name)
        && group.mem.iter().all(|member| trusted.iter().any(|user| user.name == *member))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt as _, lchown, symlink};

    use super::*;

    /// Another user than the one who runs the tests.
    const OTHER: u32 = 54_321;

    /// A library in a folder in a folder, and the path to it.
    struct Place {
        _folder: tempfile::TempDir,
        root: PathBuf,
        plugins: PathBuf,
        library: PathBuf,
    }

    fn place() -> Place {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().canonicalize().unwrap();
        let plugins = root.join("plugins");
        fs::create_dir(&plugins).unwrap();
        let library = plugins.join("libtank.so");
        fs::write(&library, "").unwrap();
        for path in [&root, &plugins] {
            set_mode(path, 0o755);
        }
        set_mode(&library, 0o644);
        Place { _folder: folder, root, plugins, library }
    }

    fn set_mode(path: &Path, mode: u32) {
        fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
    }

    /// Where trust ends on the way to `path`, and with whom.
    fn distrusted(path: &Path) -> Option<(PathBuf, Stranger)> {
        let found = first_distrust(path, Uid::effective()).unwrap();
        found.map(|distrust| (distrust.place, distrust.by))
    }

    #[test]
    fn a_library_that_only_its_user_may_write_is_trusted_also_in_a_sticky_folder() {
        let Place { root, library, .. } = &place();
        assert_eq!(distrusted(library), None);
        set_mode(root, 0o1777);
        assert_eq!(distrusted(library), None);
        assert_eq!(check_trust(library), Ok(()));
    }

    #[test]
    fn a_file_or_any_folder_above_it_that_everyone_may_write_is_not_trusted() {
        let Place { root, plugins, library, .. } = &place();
        for (path, mode) in [(library, 0o646), (plugins, 0o757), (root, 0o757)] {
            let before = path.metadata().unwrap().mode();
            set_mode(path, mode);
            assert_eq!(distrusted(library), Some((path.clone(), Stranger::Everyone)));
            set_mode(path, before);
        }
    }

    #[test]
    fn a_link_is_checked_where_it_lies_and_where_it_leads() {
        let (safe, open) = (place(), place());
        let link = open.root.join("libtank.so");
        let relative = Path::new("..").join(safe.root.file_name().unwrap()).join("plugins/libtank.so");
        for target in [safe.library.clone(), relative] {
            symlink(&target, &link).unwrap();
            assert_eq!(distrusted(&link), None, "{}", target.display());
            // The folder of the link alone is open.
            set_mode(&open.root, 0o777);
            assert_eq!(distrusted(&link), Some((open.root.clone(), Stranger::Everyone)));
            set_mode(&open.root, 0o755);
            // The folder of the target alone is open.
            set_mode(&safe.root, 0o777);
            assert_eq!(distrusted(&link), Some((safe.root.clone(), Stranger::Everyone)));
            set_mode(&safe.root, 0o755);
            fs::remove_file(&link).unwrap();
        }
    }

    #[test]
    fn links_in_a_circle_are_an_error() {
        let Place { root, .. } = &place();
        symlink("two", root.join("one")).unwrap();
        symlink("one", root.join("two")).unwrap();
        assert!(first_distrust(&root.join("one"), Uid::effective()).is_err());
    }

    #[test]
    fn what_belongs_to_another_user_is_not_trusted_even_if_it_is_a_link() {
        let Place { root, plugins, library, .. } = &place();
        let link = root.join("link");
        symlink(library, &link).unwrap();
        if Uid::effective().is_root() {
            for path in [&link, library, plugins, root] {
                lchown(path, Some(OTHER), None).unwrap();
                assert_eq!(distrusted(&link), Some((path.clone(), Stranger::Owner(OTHER))));
                lchown(path, Some(0), None).unwrap();
            }
        } else {
            // To another user, all of this is a stranger's.
            let found = first_distrust(&link, Uid::from_raw(OTHER)).unwrap().unwrap();
            assert_eq!((found.place, found.by), (root.clone(), Stranger::Owner(Uid::effective().as_raw())));
        }
    }

    #[test]
    fn a_group_may_write_only_if_it_is_the_private_one_of_a_trusted_user() {
        let named = |name: &str, gid: u32| User {
            gid: Gid::from_raw(gid),
            name: name.into(),
            ..User::from_uid(Uid::from_raw(0)).unwrap().unwrap()
        };
        let trusted = [named("ann", 1000), named("root", 0)];
        for (name, gid, members, expected) in [
            ("ann", 1000, vec![], true),
            ("ann", 1000, vec!["ann", "root"], true),
            ("root", 0, vec![], true),
            ("ann", 1000, vec!["bob"], false),
            ("users", 100, vec![], false),
            // It only bears the name, or only has the number.
            ("ann", 1001, vec![], false),
            ("users", 1000, vec![], false),
        ] {
            let mut group = Group::from_gid(Gid::from_raw(0)).unwrap().unwrap();
            group.name = name.into();
            group.gid = Gid::from_raw(gid);
            group.mem = members.into_iter().map(String::from).collect();
            assert_eq!(is_private_group_of(&group, &trusted), expected, "{group:?}");
        }
    }

    #[test]
    fn a_group_that_the_machine_does_not_know_may_not_write() {
        let Place { plugins, library, .. } = &place();
        if !Uid::effective().is_root() {
            return;
        }
        for (path, mode) in [(library, 0o664), (plugins, 0o775)] {
            set_mode(path, mode);
            assert_eq!(distrusted(library), None, "the group root is private");
            lchown(path, None, Some(OTHER)).unwrap();
            assert_eq!(distrusted(library), Some((path.clone(), Stranger::Group(OTHER))));
            lchown(path, None, Some(0)).unwrap();
        }
    }

    #[test]
    fn a_distrust_names_the_place_and_the_remedy() {
        let said = |by, is_link| Distrust { place: "/opt/x".into(), by, is_link, user: 7 }.to_string();
        for (text, expected) in [
            (said(Stranger::Owner(9), false), ["/opt/x belongs to user 9", "`chown 7 /opt/x`"]),
            (said(Stranger::Owner(9), true), ["/opt/x belongs to user 9", "`chown -h 7 /opt/x`"]),
            (said(Stranger::Group(9), false), ["/opt/x is writable by group 9", "`chmod g-w /opt/x`"]),
            (said(Stranger::Everyone, false), ["/opt/x is writable by every user", "`chmod o-w /opt/x`"]),
        ] {
            assert!(expected.iter().all(|part| text.contains(part)), "{text}");
        }
    }
}
