//! A set of node ids.

use std::fmt;

use canopen_rs::NodeId;

/// A set of node ids, of one bus.
///
/// It is of fixed size.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NodeSet(u128);

impl NodeSet {
    /// Adds a node.
    ///
    /// Real-time: yes.
    pub fn insert(&mut self, node: NodeId) {
        self.0 |= Self::bit(node);
    }

    /// Takes a node out.
    pub fn remove(&mut self, node: NodeId) {
        self.0 &= !Self::bit(node);
    }

    /// Whether a node is in it.
    pub fn contains(self, node: NodeId) -> bool {
        self.0 & Self::bit(node) != 0
    }

    /// Whether none is in it.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Returns the number of nodes in it.
    pub fn len(self) -> usize {
        self.0.count_ones() as usize
    }

    /// Returns the nodes of this set that are not in another set.
    #[must_use]
    pub fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// Its nodes, in the order of their ids.
    pub fn iter(self) -> impl Iterator<Item = NodeId> {
        (1..=127).filter_map(|raw| NodeId::new(raw).ok()).filter(move |node| self.contains(*node))
    }

    /// Returns the bit of a node. A node id is 1 to 127, so that there is a bit for each.
    fn bit(node: NodeId) -> u128 {
        1u128.checked_shl(node.raw().into()).unwrap_or_default()
    }
}

impl FromIterator<NodeId> for NodeSet {
    fn from_iter<T: IntoIterator<Item = NodeId>>(nodes: T) -> Self {
        let mut set = Self::default();
        nodes.into_iter().for_each(|node| set.insert(node));
        set
    }
}

/// `1, 2 and 10`; nothing for none.
impl fmt::Display for NodeSet {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, node) in self.iter().enumerate() {
            let before = match at {
                0 => "",
                at if at + 1 == self.len() => " and ",
                _ => ", ",
            };
            write!(out, "{before}{}", node.raw())?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(raw: &[u8]) -> NodeSet {
        raw.iter().map(|raw| NodeId::new(*raw).unwrap()).collect()
    }

    #[test]
    fn a_set_is_told_as_people_do() {
        assert_eq!(set(&[10, 1, 2, 10]).to_string(), "1, 2 and 10");
        assert_eq!(
            (set(&[127, 1]).to_string(), set(&[64]).to_string(), set(&[]).to_string()),
            ("1 and 127".into(), "64".into(), String::new())
        );
        assert_eq!(set(&[1, 2, 127]).without(set(&[2])), set(&[1, 127]));
        assert_eq!((set(&[1, 2, 127]).len(), set(&[]).is_empty()), (3, true));
    }
}
