//! The paths that a file names and the modules that it declares, held against the table.

use super::tokens::{Token, tokens};
use super::{LAYERS, ONLY_IN, may_name};

/// A `mod name;` found in a file.
pub(crate) struct Child {
    pub(crate) name: String,
    /// Content of its `#[path = ".."]`.
    pub(crate) path: Option<String>,
    pub(crate) is_test: bool,
}

/// Violations and children of a piece of source in a module of this name.
pub(crate) fn check(module: &str, source: &str) -> (Vec<String>, Vec<Child>) {
    let module: Vec<String> = module.split("::").map(str::to_owned).collect();
    let mut scan = Scan::new(source, &module, false);
    scan.items();
    (scan.violations, scan.children)
}

/// One pass over the tokens of a file.
pub(crate) struct Scan {
    tokens: Vec<(Token, usize)>,
    at: usize,
    module: Vec<String>,
    /// Depth of braces, and the inline modules that are open with the depth at which they opened.
    depth: usize,
    open: Vec<(String, usize)>,
    /// Up to which token code is for tests only.
    test_until: usize,
    pending_path: Option<String>,
    pub(crate) violations: Vec<String>,
    pub(crate) children: Vec<Child>,
}

impl Scan {
    pub(crate) fn new(source: &str, module: &[String], is_test: bool) -> Self {
        let tokens = tokens(source);
        let test_until = if is_test { tokens.len() } else { 0 };
        let module = module.to_vec();
        let (violations, children) = (Vec::new(), Vec::new());
        Self { tokens, at: 0, module, depth: 0, open: Vec::new(), test_until, pending_path: None, violations, children }
    }

    fn token(&self, at: usize) -> Option<&Token> {
        self.tokens.get(at).map(|(token, _)| token)
    }

    fn is_mark(&self, at: usize, mark: char) -> bool {
        self.token(at) == Some(&Token::Mark(mark))
    }

    fn word(&self, at: usize) -> Option<&str> {
        match self.token(at) {
            Some(Token::Word(word)) => Some(word),
            _ => None,
        }
    }

    pub(crate) fn items(&mut self) {
        while let Some(token) = self.token(self.at).cloned() {
            match token {
                Token::Mark('{') => self.depth += 1,
                Token::Mark('}') => {
                    self.depth = self.depth.saturating_sub(1);
                    self.open.retain(|(_, depth)| *depth < self.depth + 1);
                }
                Token::Mark('#') => self.attribute(),
                Token::Word(word) if word == "mod" => self.module_item(),
                Token::Word(word) if word == "use" => {
                    self.at = self.tree(self.at + 1, &[], true);
                    continue;
                }
                Token::Word(_) | Token::Path => {
                    self.at = self.tree(self.at, &[], false);
                    continue;
                }
                _ => {}
            }
            self.at += 1;
        }
    }

    /// Notes `#[cfg(test)]`, `#[test]` and `#[path = ".."]`. The content is read again as code, for the paths in it.
    fn attribute(&mut self) {
        let start = self.at + 1;
        let end = self.closing(start);
        let content: Vec<&Token> = self.tokens[start..end].iter().map(|(token, _)| token).collect();
        let has = |word: &str| content.iter().any(|token| token.is_word(word));
        let is_cfg_test = has("cfg") && has("test") && !has("any") && !has("not");
        let is_test_function = matches!(content[..], [_, Token::Word(word), ..] if word == "test");
        if let [_, Token::Word(word), Token::Mark('='), Token::Text(path), ..] = &content[..]
            && word == "path"
        {
            self.pending_path = Some(path.clone());
        }
        if is_cfg_test || is_test_function {
            self.test_until = self.test_until.max(self.end_of_item(end + 1));
        }
    }

    /// Index of the bracket that closes the one at `at`.
    fn closing(&self, at: usize) -> usize {
        let mut depth = 0usize;
        for index in at..self.tokens.len() {
            match self.token(index) {
                Some(Token::Mark('(' | '[' | '{')) => depth += 1,
                Some(Token::Mark(')' | ']' | '}')) => depth = depth.saturating_sub(1),
                _ => {}
            }
            if depth == 0 {
                return index;
            }
        }
        self.tokens.len().saturating_sub(1)
    }

    /// Index behind the item, field or statement that begins at `at`, attributes included.
    fn end_of_item(&self, mut at: usize) -> usize {
        while self.is_mark(at, '#') {
            at = self.closing(at + 1) + 1;
        }
        if self.word(at) == Some("pub") {
            at += 1;
            if self.is_mark(at, '(') {
                at = self.closing(at) + 1;
            }
        }
        let is_use = self.word(at) == Some("use");
        let is_field = self.is_mark(at + 1, ':');
        while at < self.tokens.len() {
            match self.token(at) {
                Some(Token::Mark(';')) => return at + 1,
                Some(Token::Mark(',')) if is_field => return at + 1,
                Some(Token::Mark('{')) if !is_use => return self.closing(at) + 1,
                Some(Token::Mark('(' | '[' | '{')) => at = self.closing(at),
                Some(Token::Mark(')' | ']' | '}')) => return at,
                _ => {}
            }
            at += 1;
        }
        at
    }

    fn module_item(&mut self) {
        let Some(name) = self.word(self.at + 1).map(str::to_owned) else { return };
        if self.is_mark(self.at + 2, ';') {
            let names = self.open.iter().map(|(name, _)| name.as_str()).chain([name.as_str()]);
            let name = names.collect::<Vec<_>>().join("::");
            let is_test = self.at < self.test_until;
            self.children.push(Child { name, path: self.pending_path.take(), is_test });
        } else if self.is_mark(self.at + 2, '{') {
            self.open.push((name, self.depth + 1));
        }
        self.at += 1;
    }

    /// Reads a path with its groups, notes what it names, and gives the index behind it.
    fn tree(&mut self, mut at: usize, prefix: &[String], is_use: bool) -> usize {
        let line = self.tokens.get(at).map_or(0, |(_, line)| *line);
        let mut path = prefix.to_vec();
        if self.token(at) == Some(&Token::Path) {
            at += 1;
        }
        loop {
            match self.token(at) {
                Some(Token::Word(word)) => {
                    path.push(word.clone());
                    at += 1;
                }
                Some(Token::Mark('*')) if is_use => {
                    path.push("*".to_owned());
                    at += 1;
                }
                Some(Token::Mark('{')) if is_use => {
                    at += 1;
                    while at < self.tokens.len() && !self.is_mark(at, '}') {
                        at = self.tree(at, &path, true);
                        at += usize::from(self.is_mark(at, ','));
                    }
                    return at + 1;
                }
                Some(_) => at += 1,
                None => {}
            }
            if self.token(at) != Some(&Token::Path) {
                break;
            }
            at += 1;
        }
        if is_use && self.word(at) == Some("as") {
            at += 2;
        }
        // Outside of `use`, a single word is a name of this place and not a path.
        if is_use || path.len() > 1 {
            self.note(&path, line);
        }
        at
    }

    fn note(&mut self, path: &[String], line: usize) {
        let Some(first) = path.first() else { return };
        let place = self.module.join("::");
        let mut complain = |what: String| self.violations.push(format!("line {line}: {what}"));
        let own = self.module[0].as_str();
        if let Some((name, places)) = ONLY_IN.iter().find(|(name, _)| name == first) {
            let is_inside = |inside: &str| place == inside || place.starts_with(&format!("{inside}::"));
            if !places.iter().any(|inside| is_inside(inside)) {
                complain(format!("{own} names the crate {name}"));
            }
        }
        if self.at < self.test_until || own == "lib" {
            return;
        }
        let Some(target) = self.target(path) else { return };
        let own = if own == "main" { "cli" } else { own };
        let Some(below) = may_name(own) else {
            self.violations.push(format!("line {line}: {own} is not a layer of the table"));
            return;
        };
        let is_layer = target[0] == "drives" || LAYERS.contains(&target[0].as_str());
        let is_below = |layer: &str| {
            layer.split("::").zip(&target).all(|(a, b)| a == b) && layer.split("::").count() <= target.len()
        };
        if matches!(target[0].as_str(), "*" | "self") {
            self.violations.push(format!("line {line}: {own} names the whole crate"));
        } else if is_layer && target[0] != own && !below.iter().any(|layer| is_below(layer)) {
            self.violations.push(format!("line {line}: {own} names {}", target[0]));
        }
    }

    /// The path from the root of the crate, or from `drives`; `None` for paths that lead elsewhere.
    fn target(&self, path: &[String]) -> Option<Vec<String>> {
        let mut at: Vec<String> =
            self.module.iter().cloned().chain(self.open.iter().map(|(name, _)| name.clone())).collect();
        let supers = path.iter().take_while(|segment| *segment == "super").count();
        let target = match path[0].as_str() {
            "crate" | "yieldwall" => path[1..].to_vec(),
            "yieldwall_drives" => [&["drives".to_owned()], &path[1..]].concat(),
            "super" => {
                at.truncate(at.len().saturating_sub(supers));
                [&at, &path[supers..]].concat()
            }
            _ => return None,
        };
        (!target.is_empty()).then_some(target)
    }
}
