"""The input stage: messages of trackers and /tf in, frames of people in one fixed frame out."""
