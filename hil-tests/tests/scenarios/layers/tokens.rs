//! Rust source as words and marks, without comments: as much of the language as finding paths needs.

/// A piece of source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Token {
    /// A keyword, a name or a number.
    Word(String),
    /// The content of a string.
    Text(String),
    /// `::`
    Path,
    /// Any other mark.
    Mark(char),
}

impl Token {
    /// Whether this is the word.
    pub(crate) fn is_word(&self, word: &str) -> bool {
        matches!(self, Self::Word(name) if name == word)
    }
}

/// All pieces, each with the number of its line.
pub(crate) fn tokens(source: &str) -> Vec<(Token, usize)> {
    let mut reader = Reader { rest: source, line: 1 };
    let mut all = Vec::new();
    while let Some(found) = reader.next() {
        all.push(found);
    }
    all
}

struct Reader<'a> {
    rest: &'a str,
    line: usize,
}

impl Reader<'_> {
    fn next(&mut self) -> Option<(Token, usize)> {
        self.skip_blanks_and_comments();
        let line = self.line;
        let first = self.rest.chars().next()?;
        let token = if first == '_' || first.is_alphanumeric() {
            self.word()
        } else if first == '"' {
            self.take(1);
            self.text('"', true)
        } else if first == '\'' {
            self.quote()
        } else if self.rest.starts_with("::") {
            self.take(2);
            Token::Path
        } else {
            self.take(first.len_utf8());
            Token::Mark(first)
        };
        Some((token, line))
    }

    fn take(&mut self, bytes: usize) -> &str {
        let (taken, rest) = self.rest.split_at(bytes);
        self.line += taken.matches('\n').count();
        self.rest = rest;
        taken
    }

    fn take_while(&mut self, holds: impl Fn(char) -> bool) -> &str {
        let end = self.rest.find(|c| !holds(c)).unwrap_or(self.rest.len());
        self.take(end)
    }

    fn skip_blanks_and_comments(&mut self) {
        loop {
            self.take_while(char::is_whitespace);
            if self.rest.starts_with("//") {
                self.take_while(|c| c != '\n');
            } else if self.rest.starts_with("/*") {
                self.skip_block_comment();
            } else {
                return;
            }
        }
    }

    fn skip_block_comment(&mut self) {
        let mut depth = 0;
        while !self.rest.is_empty() {
            let step = if self.rest.starts_with("/*") {
                depth += 1;
                2
            } else if self.rest.starts_with("*/") {
                depth -= 1;
                2
            } else {
                self.rest.chars().next().map_or(0, char::len_utf8)
            };
            self.take(step);
            if depth == 0 {
                return;
            }
        }
    }

    /// A word, or a string with a prefix such as `r#"` or `b"`; `r#name` is the name.
    fn word(&mut self) -> Token {
        let word = self.take_while(|c| c == '_' || c.is_alphanumeric()).to_owned();
        if !matches!(word.as_str(), "r" | "b" | "c" | "br" | "cr") {
            return Token::Word(word);
        }
        let hashes = self.rest.len() - self.rest.trim_start_matches('#').len();
        if self.rest[hashes..].starts_with('"') {
            self.take(hashes + 1);
            return match (hashes, word.ends_with('r')) {
                (0, is_raw) => self.text('"', !is_raw),
                _ => self.raw_text(&format!("\"{}", "#".repeat(hashes))),
            };
        }
        if self.rest.starts_with('#') && word == "r" {
            self.take(1);
            return self.word();
        }
        Token::Word(word)
    }

    fn text(&mut self, end: char, has_escapes: bool) -> Token {
        let mut content = String::new();
        while let Some(c) = self.rest.chars().next() {
            self.take(c.len_utf8());
            if c == end {
                break;
            }
            content.push(c);
            if let ('\\', true, Some(escaped)) = (c, has_escapes, self.rest.chars().next()) {
                self.take(escaped.len_utf8());
                content.push(escaped);
            }
        }
        Token::Text(content)
    }

    fn raw_text(&mut self, end: &str) -> Token {
        let length = self.rest.find(end).unwrap_or(self.rest.len());
        let content = self.take(length).to_owned();
        self.take(end.len().min(self.rest.len()));
        Token::Text(content)
    }

    /// A character, or the mark of a lifetime.
    fn quote(&mut self) -> Token {
        self.take(1);
        let mut ahead = self.rest.chars();
        let (first, second) = (ahead.next(), ahead.next());
        if first == Some('\\') || second == Some('\'') { self.text('\'', true) } else { Token::Mark('\'') }
    }
}
