mod coupling;
mod feed_forward;
mod joint;
mod laws;
mod margins;
