//! Objects of devices, whatever bus they are on: dictionary, values, abort codes, and requests of a master.
//!
//! CANopen (SDO) and EtherCAT (CoE) read and write the same objects in the same types and refuse them with the same codes. The parts that
//! belong to one bus, its communication objects and the transport of requests, are in the module of that bus.
//!
//! | side | what |
//! |---|---|
//! | master | [`ObjectRequest`], [`ObjectAnswer`] |
//! | device | [`ObjectDictionary`], lent by its [`ServedDevice`] to whatever speaks for it |
//! | both | [`Address`], [`DataType`], [`AbortCode`] |

mod abort;
mod access;
mod address;
mod dictionary;
mod error;
mod identity;
mod served;
mod value;

pub use abort::AbortCode;
pub use access::{ObjectAnswer, ObjectError, ObjectRequest, write_patience};
pub use address::Address;
pub use dictionary::{Access, Builder, Description, Handle, Mappable, Object, ObjectDictionary};
pub use error::DictionaryError;
pub use identity::DeviceIdentity;
pub use served::{Reset, ServedDevice};
pub use value::{DataType, Scalar};
pub use value::{load_le, mask, sign_extend};
