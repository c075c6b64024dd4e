#include "iris/calibrate/calibration_file.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <yaml-cpp/yaml.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstdlib>
#include <map>
#include <optional>
#include <sstream>
#include <string_view>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

namespace iris::calibrate {
namespace {

namespace fs = std::filesystem;
using Matrix34 = Eigen::Matrix<double, 3, 4>;

enum class Format { none, opencv, opencv_cameras, opencv_transform, kalibr, ros, sensor, kitti, middlebury };

// A file whose format is known by its content.
struct Parsed {
  fs::path file;
  Format format = Format::none;
  YAML::Node root;                      // all but kitti
  std::map<int, Matrix34> projections;  // kitti: by camera number
  bool projections_named = false;
};

std::string lower(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

// Numbers as C, YAML (.nan) and OpenCV (.Nan) write them.
std::optional<double> parse_number(std::string text) {
  text = lower(text);
  if (text == ".nan" || text == ".inf" || text == "-.inf") text.erase(text.find('.'), 1);
  if (text.empty()) return std::nullopt;
  char* end = nullptr;
  const double value = std::strtod(text.c_str(), &end);
  return *end == '\0' ? std::optional(value) : std::nullopt;
}

// --- files into trees ----------------------------------------------------------------------------------------------

// The part of XML that OpenCV's storage uses: nested elements, text split at blanks. (OpenCV's own parser crashes on
// damaged files.)
class XmlReader {
 public:
  XmlReader(const fs::path& file, std::string_view text) : file_(file), text_(text) {}

  // Content of the outermost element.
  YAML::Node read() {
    skip_to_element();
    return element(0).second;
  }

 private:
  [[noreturn]] void fail() const {
    const auto line =
        1 + std::count(text_.begin(), text_.begin() + static_cast<std::ptrdiff_t>(std::min(at_, text_.size())), '\n');
    throw InputError(file_, fmt::format("line {}: damaged XML", line), "write the calibration again");
  }
  std::string_view until(std::string_view end) {
    const size_t found = text_.find(end, at_);
    if (found == std::string_view::npos) fail();
    const std::string_view part = text_.substr(at_, found - at_);
    at_ = found + end.size();
    return part;
  }
  bool next_is(std::string_view start) const { return text_.substr(at_).starts_with(start); }

  // Over text, comments and declarations to the next "<name".
  void skip_to_element() {
    for (;;) {
      until("<");
      if (next_is("?")) {
        until("?>");
      } else if (next_is("!--")) {
        until("-->");
      } else {
        return;
      }
    }
  }

  // Stands behind '<'.
  std::pair<std::string, YAML::Node> element(int depth) {
    constexpr int kDeepest = 50;
    if (depth > kDeepest) fail();
    const std::string_view tag = until(">");
    const std::string name(tag.substr(0, tag.find_first_of(" \t\r\n/")));
    YAML::Node node;
    if (name.empty()) fail();
    if (tag.ends_with('/')) return {name, node};
    std::string words;
    for (;;) {
      words += until("<");
      if (next_is("!--")) {
        until("-->");
      } else if (next_is("/")) {
        ++at_;
        if (until(">") != name) fail();
        break;
      } else {
        auto [child_name, child] = element(depth + 1);
        if (child_name == "_") {  // OpenCV's name of list items
          if (!node.IsNull() && !node.IsSequence()) fail();
          node.push_back(child);
        } else {
          if (!node.IsNull() && !node.IsMap()) fail();
          node[child_name] = child;
        }
      }
    }
    if (!node.IsNull()) return {name, node};
    std::istringstream stream(words);
    std::vector<std::string> tokens;
    for (std::string token; stream >> token;) tokens.push_back(token);
    if (tokens.size() == 1) node = tokens[0];
    if (tokens.size() > 1) node = tokens;
    return {name, node};
  }

  const fs::path& file_;
  std::string_view text_;
  size_t at_ = 0;
};

YAML::Node parse_yaml(const fs::path& file, std::string text) {
  // OpenCV's first line is not a legal YAML directive.
  if (text.starts_with("%YAML:")) text.replace(0, std::min(text.find('\n'), text.size()), "");
  try {
    return YAML::Load(text);
  } catch (const YAML::Exception& error) {
    throw InputError(file, fmt::format("line {}: {}", error.mark.line + 1, error.msg), "mend this line");
  }
}

// "name: 12 numbers" or 12 numbers in a line. Poses look the same but have no focal length.
std::map<int, Matrix34> parse_kitti(const std::string& text, bool& named) {
  std::map<int, Matrix34> projections;
  std::istringstream lines(text);
  int unnamed = 0;
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    std::vector<std::string> tokens;
    for (std::string token; words >> token;) tokens.push_back(token);
    int number = unnamed;
    if (!tokens.empty() && tokens[0].size() == 3 && tokens[0][0] == 'P' && std::isdigit(tokens[0][1]) &&
        tokens[0][2] == ':') {
      number = tokens[0][1] - '0';
      named = true;
      tokens.erase(tokens.begin());
    }
    if (tokens.size() != 12) continue;
    Matrix34 P;
    bool good = true;
    for (int i = 0; i < 12; ++i) {
      const auto value = parse_number(tokens[static_cast<size_t>(i)]);
      good = good && value;
      P(i / 4, i % 4) = value.value_or(0);
    }
    // Only NaN and a focal length of many pixels pass: a pose has numbers up to 1 there.
    if (!good || std::abs(P(0, 0)) <= 2 || std::abs(P(1, 1)) <= 2 || P(2, 0) != 0 || P(2, 1) != 0) continue;
    ++unnamed;
    projections.emplace(number, P);
  }
  return projections;
}

// Middlebury's "name=value" lines; matrices as [a b c; d e f; g h i].
YAML::Node parse_middlebury(const std::string& text) {
  YAML::Node root;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    const size_t equals = line.find('=');
    if (equals == std::string::npos) continue;
    std::string value = line.substr(equals + 1);
    std::replace_if(
        value.begin(), value.end(), [](char c) { return c == '[' || c == ']' || c == ';' || c == '\r'; }, ' ');
    std::istringstream words(value);
    YAML::Node numbers;
    for (std::string token; words >> token;) numbers.push_back(token);
    root[line.substr(0, equals)] = numbers;
  }
  return root;
}

// --- values --------------------------------------------------------------------------------------------------------

YAML::Node first_of(const YAML::Node& map, std::initializer_list<const char*> names) {
  for (const char* name : names) {
    if (map[name]) return map[name];
  }
  return YAML::Node(YAML::NodeType::Undefined);
}

[[noreturn]] void fail_value(const fs::path& file, const std::string& name, const std::string& problem) {
  throw InputError(file, fmt::format("{} {}", name, problem), "compare the file with the documentation of its format");
}

void collect_numbers(const YAML::Node& node, const fs::path& file, const std::string& name,
                     std::vector<double>& numbers) {
  if (node.IsSequence()) {
    for (const YAML::Node& child : node) collect_numbers(child, file, name, numbers);
  } else if (node.IsScalar()) {
    const auto value = parse_number(node.Scalar());
    if (!value) fail_value(file, name, fmt::format("holds '{}', which is no number", node.Scalar()));
    numbers.push_back(*value);
  } else {
    fail_value(file, name, "is not a list of numbers");
  }
}

// Numbers of a list, a list of lists, or a map with a list `data`, row by row.
std::vector<double> numbers_of(const YAML::Node& node, const fs::path& file, const std::string& name) {
  if (!node) fail_value(file, name, "is missing");
  std::vector<double> numbers;
  if (node.IsMap() && !node["data"]) fail_value(file, name, "has no data");
  const YAML::Node data = node.IsMap() ? node["data"] : node;
  if (!data.IsNull()) collect_numbers(data, file, name, numbers);
  return numbers;
}

template <int Rows, int Cols>
Eigen::Matrix<double, Rows, Cols> matrix_of(const YAML::Node& node, const fs::path& file, const std::string& name) {
  const std::vector<double> numbers = numbers_of(node, file, name);
  if (numbers.size() != Rows * Cols) {
    fail_value(file, name, fmt::format("has {} values instead of {}x{}", numbers.size(), Rows, Cols));
  }
  Eigen::Matrix<double, Rows, Cols> matrix;
  for (int i = 0; i < Rows * Cols; ++i) matrix(i / Cols, i % Cols) = numbers[static_cast<size_t>(i)];
  return matrix;
}

int whole_number(const YAML::Node& node, const fs::path& file, const std::string& name) {
  const std::vector<double> numbers = numbers_of(node, file, name);
  if (numbers.size() != 1 || !(std::abs(numbers[0]) < 1e6)) fail_value(file, name, "is no image size");
  return static_cast<int>(numbers[0]);
}

Pose pose_of(const Eigen::Matrix3d& R, const Eigen::Vector3d& t) {
  Pose pose = Pose::Identity();
  pose.linear() = R;
  pose.translation() = t;
  return pose;
}

Pose pose_of(const YAML::Node& node, const fs::path& file, const std::string& name) {
  const Eigen::Matrix4d matrix = matrix_of<4, 4>(node, file, name);
  if (matrix.row(3) != Eigen::RowVector4d(0, 0, 0, 1)) fail_value(file, name, "does not end with the row 0 0 0 1");
  return pose_of(matrix.topLeftCorner<3, 3>(), matrix.topRightCorner<3, 1>());
}

// Inverse that does not take the linear part for a rotation: a damaged one must still be seen as such afterwards.
Pose general_inverse(const Pose& pose) {
  const Eigen::Matrix3d inverse = pose.linear().inverse();
  return pose_of(inverse, -inverse * pose.translation());
}

Eigen::Matrix3d camera_matrix(const std::vector<double>& fx_fy_cx_cy) {
  Eigen::Matrix3d K = Eigen::Matrix3d::Identity();
  K(0, 0) = fx_fy_cx_cy[0];
  K(1, 1) = fx_fy_cx_cy[1];
  K(0, 2) = fx_fy_cx_cy[2];
  K(1, 2) = fx_fy_cx_cy[3];
  return K;
}

// Sets model and coefficients from the names that the tools use.
void set_distortion(CameraModel& camera, const std::string& model, std::vector<double> coefficients,
                    const fs::path& file) {
  const std::string name = lower(model);
  if (name == "equidistant" || name == "equi" || name == "fisheye" || name == "kannala_brandt") {
    camera.distortion = Distortion::equidistant;
  } else if (name == "" || name == "radtan" || name == "radial-tangential" || name == "plumb_bob" ||
             name == "rational_polynomial" || name == "opencv") {
    camera.distortion = Distortion::radial_tangential;
  } else if (name == "none") {
    coefficients.clear();
  } else {
    throw InputError(file, fmt::format("the distortion model '{}' is not supported", model),
                     "calibrate with the radial-tangential (radtan, plumb_bob) or the equidistant (fisheye) model");
  }
  // OpenCV's 12 and 14 coefficients add thin prism and tilt: usually switched off, thus 0.
  if (camera.distortion == Distortion::radial_tangential && coefficients.size() > 8) {
    if (std::any_of(coefficients.begin() + 8, coefficients.end(), [](double c) { return c != 0; })) {
      throw InputError(file, "has thin-prism or tilt distortion coefficients, which are not supported",
                       "calibrate with at most eight coefficients");
    }
    coefficients.resize(8);
  }
  camera.coefficients = std::move(coefficients);
}

std::string text_of(const YAML::Node& node) { return node && node.IsScalar() ? node.Scalar() : std::string(); }

// --- recognition ---------------------------------------------------------------------------------------------------

constexpr std::initializer_list<const char*> kLeftMatrix = {"M1", "K1", "cameraMatrix1", "camera_matrix_1", "CM1"};
constexpr std::initializer_list<const char*> kRightMatrix = {"M2", "K2", "cameraMatrix2", "camera_matrix_2", "CM2"};
constexpr std::initializer_list<const char*> kLeftDistortion = {"D1", "distCoeffs1", "dist_coeffs_1"};
constexpr std::initializer_list<const char*> kRightDistortion = {"D2", "distCoeffs2", "dist_coeffs_2"};

Format format_of(const YAML::Node& root) {
  if (!root || !root.IsMap()) return Format::none;
  const bool cameras = first_of(root, kLeftMatrix) && first_of(root, kRightMatrix);
  const bool transform = root["R"] && root["T"];
  if (cameras) return transform ? Format::opencv : Format::opencv_cameras;
  if (transform) return Format::opencv_transform;
  if (root["cam0"] && root["cam0"].IsMap() && root["cam0"]["intrinsics"]) return Format::kalibr;
  if (root["camera_matrix"] && root["projection_matrix"]) return Format::ros;
  if (root["T_BS"] && root["intrinsics"]) return Format::sensor;
  return Format::none;
}

Parsed parse(const fs::path& file) {
  Parsed parsed;
  parsed.file = file;
  const std::string text = read_file(file);
  const size_t start = text.find_first_not_of(" \t\r\n");
  if (start == std::string::npos) throw InputError(file, "is empty", "write the calibration again");
  if (text[start] == '<') {
    parsed.root = XmlReader(file, text).read();
    parsed.format = format_of(parsed.root);
    return parsed;
  }
  parsed.projections = parse_kitti(text, parsed.projections_named);
  if (!parsed.projections.empty()) {
    parsed.format = Format::kitti;
    return parsed;
  }
  if (text.find("cam0=[") != std::string::npos) {
    parsed.root = parse_middlebury(text);
    parsed.format = Format::middlebury;
    return parsed;
  }
  parsed.root = parse_yaml(file, text);
  parsed.format = format_of(parsed.root);
  return parsed;
}

// The name of the other side's file or folder: left -> right, cam0 -> cam1 …; empty if the name has no such word.
std::string other_side(const std::string& name, bool to_right) {
  static constexpr std::array<std::array<const char*, 2>, 7> kWords = {{{"left", "right"},
                                                                        {"Left", "Right"},
                                                                        {"LEFT", "RIGHT"},
                                                                        {"cam0", "cam1"},
                                                                        {"camera0", "camera1"},
                                                                        {"_l.", "_r."},
                                                                        {"_0.", "_1."}}};
  for (const auto& words : kWords) {
    const std::string from = words[to_right ? 0 : 1];
    const size_t at = name.rfind(from);
    if (at != std::string::npos) return std::string(name).replace(at, from.size(), words[to_right ? 1 : 0]);
  }
  return "";
}

// The file beside this one (or in the folder beside this one's) that belongs to the other camera.
std::optional<fs::path> sibling(const fs::path& file, bool to_right) {
  if (const std::string name = other_side(file.filename().string(), to_right); !name.empty()) {
    if (const fs::path path = file.parent_path() / name; fs::exists(path)) return path;
  }
  const fs::path folder = fs::absolute(file).parent_path();
  if (const std::string name = other_side(folder.filename().string(), to_right); !name.empty()) {
    if (const fs::path path = folder.parent_path() / name / file.filename(); fs::exists(path)) return path;
  }
  return std::nullopt;
}

// (left, right) files of a format with one file a camera, whichever of them is given.
std::pair<fs::path, fs::path> file_pair(const fs::path& file, const char* format) {
  if (const auto right = sibling(file, true)) return {file, *right};
  if (const auto left = sibling(file, false)) return {*left, file};
  throw InputError(file, fmt::format("is the {} file of one camera; the other camera's file is not beside it", format),
                   "put both into one folder and name them alike, with left and right (or cam0 and cam1) in the names");
}

std::vector<fs::path> calibration_like_files(const fs::path& folder) {
  std::vector<fs::path> files;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
    const std::string extension = lower(entry.path().extension().string());
    const bool candidate = extension == ".yaml" || extension == ".yml" || extension == ".xml" || extension == ".txt";
    constexpr uintmax_t kLargest = 1 << 20;  // bytes: calibrations are small; long logs and trajectories are not opened
    if (!candidate || !entry.is_regular_file() || entry.path().filename().string().starts_with('.')) continue;
    if (entry.file_size() <= kLargest) files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

// --- the formats ---------------------------------------------------------------------------------------------------

StereoCalibration read_opencv(const Parsed& cameras, const Parsed& transform) {
  StereoCalibration c;
  const auto camera = [&](CameraModel& model, const YAML::Node& K, const YAML::Node& D, const std::string& number) {
    model.K = matrix_of<3, 3>(K, cameras.file, "M" + number);
    set_distortion(model, text_of(cameras.root["distortion_model"]),
                   D ? numbers_of(D, cameras.file, "D" + number) : std::vector<double>(), cameras.file);
    for (const Parsed* parsed : {&cameras, &transform}) {
      const YAML::Node& root = parsed->root;
      if (root["image_width"] && root["image_height"]) {
        model.width = whole_number(root["image_width"], parsed->file, "image_width");
        model.height = whole_number(root["image_height"], parsed->file, "image_height");
      } else if (const YAML::Node size = first_of(root, {"image_size", "imageSize", "size"})) {
        const auto values = matrix_of<2, 1>(size, parsed->file, "image_size");
        model.width = static_cast<int>(values(0));
        model.height = static_cast<int>(values(1));
      }
    }
  };
  camera(c.left, first_of(cameras.root, kLeftMatrix), first_of(cameras.root, kLeftDistortion), "1");
  camera(c.right, first_of(cameras.root, kRightMatrix), first_of(cameras.root, kRightDistortion), "2");
  c.right_from_left = pose_of(matrix_of<3, 3>(transform.root["R"], transform.file, "R"),
                              matrix_of<3, 1>(transform.root["T"], transform.file, "T"));
  return c;
}

// stereo_calib writes intrinsics.yml and extrinsics.yml: finds the other one of the two.
StereoCalibration read_opencv_halves(const Parsed& given) {
  const Format wanted = given.format == Format::opencv_cameras ? Format::opencv_transform : Format::opencv_cameras;
  std::vector<Parsed> found;
  for (const fs::path& file : calibration_like_files(fs::absolute(given.file).parent_path())) {
    try {
      if (Parsed parsed = parse(file); parsed.format == wanted) found.push_back(std::move(parsed));
    } catch (const InputError&) {  // some other file that happens to lie here
    }
  }
  if (found.size() != 1) {
    throw InputError(
        given.file,
        wanted == Format::opencv_transform ? "has the cameras (M1, M2) but not R and T"
                                           : "has R and T but not the cameras (M1, M2)",
        fmt::format("they may stand in another file of the same folder, of which {} were found; one is needed",
                    found.size()));
  }
  return wanted == Format::opencv_transform ? read_opencv(given, found[0]) : read_opencv(found[0], given);
}

CameraModel read_pinhole(const YAML::Node& node, const char* coefficients, const fs::path& file,
                         const std::string& name) {
  CameraModel camera;
  const std::string model = text_of(node["camera_model"]);
  if (!model.empty() && model != "pinhole") {
    throw InputError(file, fmt::format("{}: the camera model '{}' is not supported", name, model),
                     "calibrate with the pinhole model and radtan or equi distortion");
  }
  const std::vector<double> intrinsics = numbers_of(node["intrinsics"], file, name + ".intrinsics");
  if (intrinsics.size() != 4) fail_value(file, name + ".intrinsics", "must be [fu, fv, cu, cv]");
  camera.K = camera_matrix(intrinsics);
  set_distortion(
      camera, text_of(node["distortion_model"]),
      node[coefficients] ? numbers_of(node[coefficients], file, name + "." + coefficients) : std::vector<double>(),
      file);
  if (node["resolution"]) {
    const auto size = matrix_of<2, 1>(node["resolution"], file, name + ".resolution");
    camera.width = static_cast<int>(size(0));
    camera.height = static_cast<int>(size(1));
  }
  return camera;
}

StereoCalibration read_kalibr(const Parsed& parsed) {
  const YAML::Node cam0 = parsed.root["cam0"], cam1 = parsed.root["cam1"];
  if (!cam1 || !cam1.IsMap()) {
    throw InputError(parsed.file, "is a camchain of one camera", "calibrate both cameras together");
  }
  StereoCalibration c;
  c.left = read_pinhole(cam0, "distortion_coeffs", parsed.file, "cam0");
  c.right = read_pinhole(cam1, "distortion_coeffs", parsed.file, "cam1");
  if (cam1["T_cn_cnm1"]) {
    c.right_from_left = pose_of(cam1["T_cn_cnm1"], parsed.file, "cam1.T_cn_cnm1");
  } else if (cam0["T_cam_imu"] && cam1["T_cam_imu"]) {
    const Pose left_from_imu = pose_of(cam0["T_cam_imu"], parsed.file, "cam0.T_cam_imu");
    c.right_from_left = pose_of(cam1["T_cam_imu"], parsed.file, "cam1.T_cam_imu") * general_inverse(left_from_imu);
  } else {
    fail_value(parsed.file, "cam1.T_cn_cnm1", "is missing");
  }
  return c;
}

struct RosCamera {
  CameraModel model;
  Eigen::Matrix3d rect_from_cam;
  Matrix34 P;
};

RosCamera read_ros_camera(const Parsed& parsed) {
  const YAML::Node& root = parsed.root;
  RosCamera camera;
  camera.model.width = whole_number(root["image_width"], parsed.file, "image_width");
  camera.model.height = whole_number(root["image_height"], parsed.file, "image_height");
  camera.model.K = matrix_of<3, 3>(root["camera_matrix"], parsed.file, "camera_matrix");
  set_distortion(camera.model, text_of(root["distortion_model"]),
                 numbers_of(root["distortion_coefficients"], parsed.file, "distortion_coefficients"), parsed.file);
  camera.rect_from_cam = matrix_of<3, 3>(root["rectification_matrix"], parsed.file, "rectification_matrix");
  camera.P = matrix_of<3, 4>(root["projection_matrix"], parsed.file, "projection_matrix");
  return camera;
}

StereoCalibration read_ros(const fs::path& file) {
  const auto [left_file, right_file] = file_pair(file, "ROS camera_info");
  const Parsed left_parsed = parse(left_file), right_parsed = parse(right_file);
  if (left_parsed.format != Format::ros || right_parsed.format != Format::ros) {
    throw InputError(left_parsed.format != Format::ros ? left_file : right_file, "is no ROS camera_info file",
                     "both cameras need one with camera_matrix, rectification_matrix and projection_matrix");
  }
  const RosCamera left = read_ros_camera(left_parsed), right = read_ros_camera(right_parsed);
  StereoCalibration c;
  c.left = left.model;
  c.right = right.model;
  // Both rectified frames have the same axes; their origins differ by P[.][3] / f.
  const auto offset = [](const Matrix34& P) { return Eigen::Vector3d(P(0, 3) / P(0, 0), P(1, 3) / P(1, 1), 0); };
  const Eigen::Matrix3d right_cam_from_rect = right.rect_from_cam.transpose();
  c.right_from_left =
      pose_of(right_cam_from_rect * left.rect_from_cam, right_cam_from_rect * (offset(right.P) - offset(left.P)));
  return c;
}

StereoCalibration read_sensors(const fs::path& file) {
  const auto [left_file, right_file] = file_pair(file, "sensor.yaml");
  const Parsed left = parse(left_file), right = parse(right_file);
  if (left.format != Format::sensor || right.format != Format::sensor) {
    throw InputError(left.format != Format::sensor ? left_file : right_file, "is no camera's sensor.yaml",
                     "both cameras need one with T_BS, intrinsics and resolution");
  }
  StereoCalibration c;
  c.left = read_pinhole(left.root, "distortion_coefficients", left_file, "camera");
  c.right = read_pinhole(right.root, "distortion_coefficients", right_file, "camera");
  const Pose body_from_left = pose_of(left.root["T_BS"], left_file, "T_BS");
  const Pose body_from_right = pose_of(right.root["T_BS"], right_file, "T_BS");
  c.right_from_left = general_inverse(body_from_right) * body_from_left;
  return c;
}

StereoCalibration read_kitti(const Parsed& parsed, KittiPair pair) {
  const auto has = [&](int number) { return parsed.projections.contains(number); };
  const bool grey = has(0) && has(1), colour = has(2) && has(3);
  if (pair == KittiPair::any) pair = grey || !colour ? KittiPair::grey : KittiPair::colour;
  if (pair == KittiPair::rather_colour) pair = colour || !grey ? KittiPair::colour : KittiPair::grey;
  const bool just_the_pair = !parsed.projections_named && parsed.projections.size() == 2;
  const int first = pair == KittiPair::grey || just_the_pair ? 0 : 2;
  if (!has(first) || !has(first + 1)) {
    throw InputError(parsed.file, fmt::format("has no P{} and P{}", first, first + 1),
                     "add the projection matrices of these two cameras (12 numbers each)");
  }
  StereoCalibration c;
  // P = K [1 | t] with t from the frame of camera 0 into this camera's frame.
  const Matrix34 &P_left = parsed.projections.at(first), &P_right = parsed.projections.at(first + 1);
  c.left.K = P_left.leftCols<3>();
  c.right.K = P_right.leftCols<3>();
  c.right_from_left.translation() = c.right.K.inverse() * P_right.col(3) - c.left.K.inverse() * P_left.col(3);
  c.rectified = true;
  if (c.left.K.row(1) != c.right.K.row(1) || c.left.K(0, 0) != c.right.K(0, 0)) {
    throw InputError(parsed.file, fmt::format("P{} and P{} have different focal lengths or rows", first, first + 1),
                     "projection matrices of a rectified pair agree in them");
  }
  return c;
}

StereoCalibration read_middlebury(const Parsed& parsed) {
  StereoCalibration c;
  c.left.K = matrix_of<3, 3>(parsed.root["cam0"], parsed.file, "cam0");
  c.right.K = matrix_of<3, 3>(parsed.root["cam1"], parsed.file, "cam1");
  const double baseline_mm = matrix_of<1, 1>(parsed.root["baseline"], parsed.file, "baseline")(0);
  c.right_from_left.translation() = Eigen::Vector3d(-baseline_mm / 1000, 0, 0);
  if (parsed.root["width"] && parsed.root["height"]) {
    c.left.width = c.right.width = whole_number(parsed.root["width"], parsed.file, "width");
    c.left.height = c.right.height = whole_number(parsed.root["height"], parsed.file, "height");
  }
  c.rectified = true;
  return c;
}

StereoCalibration read_format(const Parsed& parsed, KittiPair pair) {
  switch (parsed.format) {
    case Format::opencv:
      return read_opencv(parsed, parsed);
    case Format::opencv_cameras:
    case Format::opencv_transform:
      return read_opencv_halves(parsed);
    case Format::kalibr:
      return read_kalibr(parsed);
    case Format::ros:
      return read_ros(parsed.file);
    case Format::sensor:
      return read_sensors(parsed.file);
    case Format::kitti:
      return read_kitti(parsed, pair);
    case Format::middlebury:
      return read_middlebury(parsed);
    case Format::none:
      break;
  }
  throw InputError(parsed.file, "is no stereo calibration", understood_calibrations());
}

}  // namespace

std::string understood_calibrations() {
  return "understood are OpenCV YAML/XML (M1 D1 M2 D2 R T), Kalibr camchain, a pair of ROS camera_info files "
         "(left/right), "
         "KITTI calib.txt (P0: …), EuRoC cam0/sensor.yaml with cam1/sensor.yaml, Middlebury calib.txt";
}

std::vector<fs::path> find_calibrations(const fs::path& folder, std::vector<std::string>* broken) {
  std::vector<fs::path> found;
  for (const fs::path& file : calibration_like_files(folder)) {
    try {
      const Format format = parse(file).format;
      if (format == Format::none || format == Format::opencv_transform) continue;  // the latter comes with its cameras
      const bool one_of_two = format == Format::ros || format == Format::sensor;
      if (one_of_two && !sibling(file, true)) {
        if (sibling(file, false)) continue;  // found by its left file
        if (broken) broken->push_back(file.filename().string() + " (one camera only)");
        continue;
      }
      if (file.stem() == "calibration") return {file};
      found.push_back(file);
    } catch (const InputError& error) {
      if (broken) broken->push_back(error.what());
    }
  }
  return found;
}

StereoCalibration read_calibration(const fs::path& file_or_folder, KittiPair pair) {
  if (!fs::exists(file_or_folder)) {
    throw InputError(file_or_folder, "there is no such calibration", "check the name");
  }
  fs::path file = file_or_folder;
  if (fs::is_directory(file_or_folder)) {
    file.clear();
    for (const fs::path& base : {file_or_folder, file_or_folder / "mav0"}) {
      if (fs::exists(base / "cam0/sensor.yaml") && fs::exists(base / "cam1/sensor.yaml"))
        file = base / "cam0/sensor.yaml";
    }
    if (file.empty()) {
      std::vector<std::string> broken;
      const std::vector<fs::path> found = find_calibrations(file_or_folder, &broken);
      if (found.empty()) {
        throw InputError(file_or_folder,
                         broken.empty() ? "has no calibration (*.yaml, *.yml, *.xml, *.txt)"
                                        : fmt::format("has no readable calibration ({})", fmt::join(broken, "; ")),
                         understood_calibrations());
      }
      if (found.size() > 1) {
        std::vector<std::string> names;
        for (const fs::path& path : found) names.push_back(path.filename().string());
        throw InputError(file_or_folder, fmt::format("has {} calibrations: {}", names.size(), fmt::join(names, ", ")),
                         "name the right one, or rename it to calibration" + found[0].extension().string());
      }
      file = found[0];
    }
  }
  StereoCalibration calibration;
  try {
    calibration = read_format(parse(file), pair);
  } catch (const YAML::Exception& error) {  // a list where a value belongs, and the like
    throw InputError(file, "is not built as its format says: " + error.msg, understood_calibrations());
  }
  calibration.source = file.string();
  validate(calibration, file, true);
  // Files round their values: make the rotation exact.
  calibration.right_from_left.linear() = nearest_rotation(calibration.right_from_left.linear());
  calibration.rectified = calibration.rectified || is_rectified(calibration);
  return calibration;
}

}  // namespace iris::calibrate
