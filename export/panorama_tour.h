// Tours of panoramas that one clicks through in a browser, shown by Pannellum (https://pannellum.org, MIT licence).
#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "export/products.h"
#include "iris/tour/panorama.h"

namespace iris::exporters {

struct PanoramaRequest {
  std::filesystem::path output;     // a folder, or one .html file that holds everything
  std::vector<Eigen::Vector2d> at;  // [m] where panoramas stand; empty = chosen
  bool preview = false;             // a quarter of the width
  std::filesystem::path pannellum;  // folder with pannellum.js and pannellum.css; empty = the page loads them from a
                                    // public server
};

// Into a folder:
//   index.html       the page. Browsers load its pictures only from a server (python3 -m http.server), not from file://
//   000000.jpg …     equirectangular panoramas; the middle column looks along the world's x
//   tour.json        positions and links; "pannellum" in it is the configuration for Pannellum
//   pannellum/       what was given
// Into one file: the page with all of that inside, which opens from anywhere.
// Returns the number of panoramas. Goes on behind the last finished panorama when called again after an interruption.
// Throws UsageError for places that are not free, InputError if Pannellum's files are not where they should be.
int write_panorama_tour(const workspace::Workspace& workspace, const RunOptions& options,
                        const PanoramaRequest& request, const pipeline::RunControl& control);

// Pannellum's configuration: one scene a node, named node0 …, with a link at the direction of each neighbour. All
// panoramas have the same axes: one goes on looking in the direction in which one went. `images`: their addresses.
nlohmann::json pannellum_config(const std::vector<tour::PanoramaNode>& nodes, const std::vector<std::string>& images,
                                const std::string& title);

}  // namespace iris::exporters
