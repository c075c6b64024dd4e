// The thesis's tables and figures, measured with this code; each function prints its part as Markdown.
#pragma once

namespace iris::thesis {

void print_stereo_tables();   // chapter 3, on the Tsukuba images
void print_motion_tables();   // chapter 5, on simulated sequences
void print_mapping_tables();  // chapter 6, on the two simulated boxes
void print_view_tables();     // chapter 7, on the two simulated boxes

}  // namespace iris::thesis
