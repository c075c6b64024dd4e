// The program as its users call it: exit codes, messages, resuming, the same bytes every time.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <map>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <random>
#include <regex>
#include <set>
#include <sstream>
#include <thread>

#include "iris/core/atomic_file.h"
#include "support/program.h"
#include "support/synthetic_session.h"
#include "support/temporary_folder.h"

namespace iris {
namespace {

namespace fs = std::filesystem;
using iris::testing::run_program;
using iris::testing::TemporaryFolder;
using iris::testing::write_synthetic_session;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

// Small pictures and a short tour: the tests look at behaviour, not at quality.
const std::vector<std::string> kFast = {"--stereo.disparities", "48",  "--tour.seconds", "1", "--tour.width", "160",
                                        "--tour.height",        "120", "--quiet"};

std::vector<std::string> run_arguments(const fs::path& session, const fs::path& out,
                                       std::vector<std::string> more = {}) {
  std::vector<std::string> arguments = {"run", session.string(), "-o", out.string()};
  arguments.insert(arguments.end(), kFast.begin(), kFast.end());
  arguments.insert(arguments.end(), more.begin(), more.end());
  return arguments;
}

// Everything a run makes, but for its records and its log.
std::map<std::string, std::string> products_of(const fs::path& out) {
  std::map<std::string, std::string> files;
  for (const auto& entry : fs::recursive_directory_iterator(out)) {
    const std::string name = fs::relative(entry.path(), out).string();
    if (!entry.is_regular_file() || name.starts_with("workspace.db") || name == "log.txt" || name == ".lock") continue;
    files[name] = read_file(entry.path());
  }
  return files;
}

void expect_equal_products(const fs::path& expected, const fs::path& actual) {
  const auto a = products_of(expected), b = products_of(actual);
  ASSERT_GT(a.size(), 15u);
  for (const auto& [name, bytes] : a) {
    ASSERT_TRUE(b.contains(name)) << name << " is missing";
    EXPECT_TRUE(b.at(name) == bytes) << name << " differs";
  }
  EXPECT_EQ(a.size(), b.size());
}

class Cli : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new TemporaryFolder;
    write_synthetic_session(session(), 14);
    const auto result = run_program(run_arguments(session(), folder_->path() / "reference", {"--threads", "1"}));
    ASSERT_EQ(result.exit_code, 0) << result.output;
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }
  static fs::path session() { return folder_->path() / "session"; }
  static fs::path reference() { return folder_->path() / "reference"; }
  static fs::path fresh(const std::string& name) {
    fs::remove_all(folder_->path() / name);
    return folder_->path() / name;
  }
  // A copy of the session that a test may damage.
  static fs::path copied(const std::string& name) {
    const fs::path copy = fresh(name);
    fs::copy(session(), copy, fs::copy_options::recursive);
    return copy;
  }

  static TemporaryFolder* folder_;
};
TemporaryFolder* Cli::folder_ = nullptr;

TEST_F(Cli, RunWritesEveryProduct) {
  for (const char* file : {"trajectory/tum.txt",
                           "trajectory/kitti.txt",
                           "trajectory/graph.g2o",
                           "map/map.png",
                           "map/map.pgm",
                           "map/map.yaml",
                           "map/map.pgw",
                           "map/layers.png",
                           "map/sheet.pdf",
                           "map/sheet.svg",
                           "map/sheet.png",
                           "octree/map.bt",
                           "octree/map.ot",
                           "model/cloud.ply",
                           "model/cloud.pcd",
                           "model/mesh.ply",
                           "model/scene.glb",
                           "tour/tour.mp4",
                           "tour/frames/000000.png",
                           "report/index.html",
                           "views/000000.left.png",
                           "views/000000.disparity.png",
                           "views/000000.origin.png",
                           "options.toml",
                           "log.txt",
                           "workspace.db"}) {
    EXPECT_TRUE(fs::exists(reference() / file)) << file;
  }
  EXPECT_THAT(read_file(reference() / "log.txt"), HasSubstr("14 of 14 frames have a pose"));  // although it ran quietly
}

TEST_F(Cli, TheSheetSaysWhatWasRecordedAndHowWell) {
  const fs::path text = fresh("sheet.txt");
  ASSERT_EQ(
      std::system(("pdftotext -layout " + (reference() / "map/sheet.pdf").string() + " " + text.string()).c_str()), 0);
  const std::string sheet = read_file(text);
  for (const char* line :
       {"Session +session", "Recorded +date not recorded", "Camera +320 x 240 px, f 260 px, base 100 mm",
        "Path +0\\.[0-9]+ m, 14 poses", "Closing error +the path does not come back to itself", "Explored +[0-9.]+ m²",
        "Occupied +[0-9.]+ m²", "Software +IRIS [0-9]", "1 : [0-9]+", "map cell 0.05 m"}) {
    EXPECT_THAT(sheet, ::testing::ContainsRegex(line));
  }
}

// Every file that the report refers to is there, and it tells what `info` tells.
TEST_F(Cli, TheReportShowsWhatWasMade) {
  const std::string page = read_file(reference() / "report/index.html");
  const std::regex link("(?:href|src)=\"([^\"]+)\"");
  std::set<std::string> files;
  for (std::sregex_iterator at(page.begin(), page.end(), link), end; at != end; ++at) {
    files.insert((*at)[1]);
    EXPECT_TRUE(fs::exists(reference() / "report" / (*at)[1].str())) << (*at)[1];
  }
  for (const char* file : {"../tour/tour.mp4", "../map/map_picture.png", "../map/sheet.pdf", "../octree/map.ot",
                           "../model/scene.glb", "../trajectory/tum.txt", "view_000000.jpg", "motions.svg"}) {
    EXPECT_TRUE(files.contains(file)) << file;
  }
  EXPECT_THAT(page, AllOf(HasSubstr("<h1>session</h1>"), HasSubstr("14 of 14 with a pose"),
                          HasSubstr("<code>stereo.disparities</code></td><td>48</td><td>0</td>")));
  // The one thing that this recording leaves open: it shows no floor.
  const size_t warning = page.find("class=warning");
  EXPECT_EQ(page.find("class=warning>The up of sub-map 0 is a guess"), warning);
  EXPECT_EQ(page.find("class=warning", warning + 1), std::string::npos);
}

TEST_F(Cli, ThePathIsTheSimulatedOne) {
  std::istringstream lines(read_file(reference() / "trajectory/tum.txt"));
  double t, x, y, z, qx, qy, qz, qw;
  int count = 0;
  while (lines >> t >> x >> y >> z >> qx >> qy >> qz >> qw) {
    // World: x forward, y left, z up; 0.1 px of a corner's position is 5 mm at the scene's distance, and a hundred
    // corners are averaged.
    const Eigen::Vector3d truth = iris::testing::synthetic_position(count);
    EXPECT_LT((Eigen::Vector3d(x, y, z) - truth).norm(), 0.01) << "frame " << count;
    ++count;
  }
  EXPECT_EQ(count, 14);
}

TEST_F(Cli, TwoThreadsGiveTheSameBytes) {
  const fs::path out = fresh("two_threads");
  ASSERT_EQ(run_program(run_arguments(session(), out, {"--threads", "2"})).exit_code, 0);
  expect_equal_products(reference(), out);
}

TEST_F(Cli, KilledAtRandomMomentsItEndsWithTheSameBytes) {
  const fs::path out = fresh("killed");
  std::mt19937 random(5);
  int kills = 0;
  for (int attempt = 0; kills < 10 && attempt < 40; ++attempt) {
    const int milliseconds = std::uniform_int_distribution<>(20, 1500)(random);
    if (iris::testing::start_and_kill(run_arguments(session(), out), std::chrono::milliseconds(milliseconds))) ++kills;
  }
  EXPECT_GE(kills, 1);
  ASSERT_EQ(run_program(run_arguments(session(), out)).exit_code, 0);
  expect_equal_products(reference(), out);
}

TEST_F(Cli, InterruptedItSaysSoAndGoesOn) {
  const fs::path out = fresh("interrupted");
  const int code =
      iris::testing::start_and_signal(run_arguments(session(), out), std::chrono::milliseconds(300), SIGINT);
  EXPECT_TRUE(code == 130 || code == 0) << code;
  ASSERT_EQ(run_program(run_arguments(session(), out)).exit_code, 0);
  expect_equal_products(reference(), out);
}

TEST_F(Cli, ChangedOptionsRedoTheirStageAndNothingBefore) {
  const fs::path out = fresh("changed");
  fs::copy(reference(), out, fs::copy_options::recursive);
  const auto frames_time = fs::last_write_time(out / "views/000000.left.png");
  const auto cloud_time = fs::last_write_time(out / "model/cloud.ply");
  const auto map_time = fs::last_write_time(out / "map/map.pgm");
  auto arguments = run_arguments(session(), out, {"--mapping.cell", "0.1"});
  ASSERT_EQ(run_program(arguments).exit_code, 0);
  EXPECT_EQ(fs::last_write_time(out / "views/000000.left.png"), frames_time);
  EXPECT_EQ(fs::last_write_time(out / "model/cloud.ply"), cloud_time);
  EXPECT_NE(fs::last_write_time(out / "map/map.pgm"), map_time);
  EXPECT_THAT(read_file(out / "map/map.yaml"), HasSubstr("resolution: 0.1"));

  // An option of the matcher changes everything.
  ASSERT_EQ(run_program(run_arguments(session(), out, {"--stereo.min_segment", "50"})).exit_code, 0);
  EXPECT_NE(fs::last_write_time(out / "views/000000.left.png"), frames_time);
  EXPECT_NE(fs::last_write_time(out / "model/cloud.ply"), cloud_time);

  // And back: equal to the first result again.
  ASSERT_EQ(run_program(run_arguments(session(), out)).exit_code, 0);
  expect_equal_products(reference(), out);
}

TEST_F(Cli, ARemovedProductIsMadeAgain) {
  const fs::path out = fresh("removed");
  fs::copy(reference(), out, fs::copy_options::recursive);
  fs::remove(out / "map/map.png");
  ASSERT_EQ(run_program(run_arguments(session(), out)).exit_code, 0);
  expect_equal_products(reference(), out);
}

TEST_F(Cli, AChangedCalibrationRedoesEverythingInTheSameFolder) {
  const fs::path changed = copied("recalibrated"), out = fresh("recalibrated_out");
  fs::copy(reference(), out, fs::copy_options::recursive);
  std::string calibration = read_file(changed / "calibration.yaml");
  const size_t at = calibration.find("-0.1, 0., 0.");
  ASSERT_NE(at, std::string::npos);
  write_file(changed / "calibration.yaml", calibration.replace(at, 4, "-0.2"));
  ASSERT_EQ(run_program(run_arguments(changed, out)).exit_code, 0);
  EXPECT_NE(read_file(out / "trajectory/tum.txt"), read_file(reference() / "trajectory/tum.txt"));
}

TEST_F(Cli, ATruncatedImageCostsItsFrameOnly) {
  const fs::path damaged = copied("truncated"), out = fresh("truncated_out");
  fs::resize_file(damaged / "left/000005.png", fs::file_size(damaged / "left/000005.png") / 2);
  const auto result = run_program(run_arguments(damaged, out));
  EXPECT_EQ(result.exit_code, 4) << result.output;
  EXPECT_THAT(result.output, AllOf(HasSubstr("frame 5 is skipped"), HasSubstr("000005.png")));
  std::istringstream kitti(read_file(out / "trajectory/kitti.txt"));
  std::string line;
  int count = 0;
  while (std::getline(kitti, line)) {
    EXPECT_EQ(line.find("nan") != std::string::npos, count == 5) << line;
    ++count;
  }
  EXPECT_EQ(count, 14);
  EXPECT_THAT(run_program({"info", out.string()}).output, HasSubstr("000005.png"));
}

TEST_F(Cli, ADamagedFirstImageCostsItsFrameOnly) {
  const fs::path damaged = copied("first_truncated"), out = fresh("first_truncated_out");
  fs::resize_file(damaged / "right/000000.png", 200);
  write_file(damaged / "left/000001.png", "no image");
  const auto result = run_program(run_arguments(damaged, out));
  EXPECT_EQ(result.exit_code, 4) << result.output;
  EXPECT_THAT(result.output, AllOf(HasSubstr("right/000000.png"), HasSubstr("frame 2 is the first that can be read"),
                                   HasSubstr("frame 0 is skipped"), HasSubstr("frame 1 is skipped")));
  const auto info = run_program({"info", out.string()});
  EXPECT_THAT(info.output, AllOf(HasSubstr("14: 12 with a pose, 2 unreadable, 0 that show too little, 1 sub-map\n"),
                                 HasSubstr("begins the path")));
  // A given search range looks for one frame that can be used: the one in the middle is tried first.
  const fs::path middle = copied("middle_truncated");
  for (const char* name : {"left/000000.png", "left/000001.png", "left/000007.png"}) write_file(middle / name, "");
  EXPECT_EQ(run_program(run_arguments(middle, fresh("middle_out"))).exit_code, 4);
  // Nothing at all can be read.
  for (const auto& entry : fs::directory_iterator(middle / "left")) write_file(entry.path(), "");
  const auto nothing = run_program(run_arguments(middle, fresh("nothing_out")));
  EXPECT_EQ(nothing.exit_code, 3);
  EXPECT_THAT(nothing.output, AllOf(HasSubstr("none of its 14 frames can be read"), HasSubstr("left/000000.png")));
}

TEST_F(Cli, WrongUsageIsExitCode2) {
  EXPECT_EQ(run_program({}).exit_code, 2);
  const auto fly = run_program({"fly", session().string()});
  EXPECT_EQ(fly.exit_code, 2);
  EXPECT_THAT(fly.output, HasSubstr("'fly' is no command of iris; choose from run, info"));
  const auto unknown = run_program({"run", session().string(), "-o", fresh("x").string(), "--stereo.disparites", "64"});
  EXPECT_EQ(unknown.exit_code, 2);
  EXPECT_THAT(unknown.output, HasSubstr("did you mean stereo.disparities?"));
  const auto range = run_program(
      {"run", session().string(), "-o", fresh("x").string(), "--stereo.disparities", "5000", "--mapping.cell", "-1"});
  EXPECT_EQ(range.exit_code, 2);
  EXPECT_THAT(range.output, AllOf(HasSubstr("stereo.disparities = 5000"), HasSubstr("mapping.cell = -1")));
  write_file(folder_->path() / "bad.toml", "[stereo]\ndisparites = 64\n");
  const auto file = run_program(
      {"run", session().string(), "-o", fresh("x").string(), "--config", (folder_->path() / "bad.toml").string()});
  EXPECT_EQ(file.exit_code, 2);
  EXPECT_THAT(file.output, AllOf(HasSubstr("bad.toml"), HasSubstr("did you mean stereo.disparities?")));
  const auto foreign = run_program({"tour", reference().string(), "-o", "x.mp4", "--mapping.cell", "0.1"});
  EXPECT_EQ(foreign.exit_code, 2);
  EXPECT_THAT(foreign.output, HasSubstr("--mapping.cell is no option of 'iris tour'"));
  EXPECT_EQ(run_program({"tour", reference().string(), "-o", "x.avi"}).exit_code, 2);
  EXPECT_EQ(run_program(run_arguments(session(), fresh("x"), {"--tour.width", "161"})).exit_code, 2);
  // Error pictures need a folder.
  EXPECT_EQ(run_program({"evaluate", reference().string(), "--truth", session().string(), "--view", "0"}).exit_code, 2);
  const auto neither = run_program({"simulate", "castle", "-o", fresh("x").string()});
  EXPECT_EQ(neither.exit_code, 2);
  EXPECT_THAT(neither.output, AllOf(HasSubstr("neither a file nor a scene 'castle'"), HasSubstr("apartment")));
  EXPECT_EQ(run_program({"--help"}).exit_code, 0);
  EXPECT_THAT(run_program({"run", "--help"}).output, AllOf(HasSubstr("--stereo.disparities"), HasSubstr("px")));
}

TEST_F(Cli, TheCommandLineWinsOverTheFileAndTheFileOverTheDefault) {
  const fs::path out = fresh("precedence");
  write_file(folder_->path() / "good.toml", "mapping.cell = 0.2\n[tour]\nfps = 5.0\n");
  ASSERT_EQ(run_program(run_arguments(session(), out,
                                      {"--config", (folder_->path() / "good.toml").string(), "--mapping.cell", "0.1"}))
                .exit_code,
            0);
  const std::string options = read_file(out / "options.toml");
  EXPECT_THAT(options, AllOf(HasSubstr("cell = 0.1 "), HasSubstr("fps = 5.0 ")));
}

TEST_F(Cli, BadInputIsExitCode3AndNamesFileProblemAndRemedy) {
  const auto expect = [&](const fs::path& input, const fs::path& out, const std::vector<std::string>& words) {
    const auto result = run_program(run_arguments(input, out));
    EXPECT_EQ(result.exit_code, 3) << result.output;
    for (const std::string& word : words) EXPECT_THAT(result.output, HasSubstr(word));
  };
  const fs::path nowhere = fresh("nowhere");
  expect(nowhere, fresh("o"), {nowhere.string()});
  const fs::path empty = fresh("empty");
  fs::create_directories(empty);
  expect(empty, fresh("o"), {empty.string()});

  const fs::path sizes = copied("sizes");
  for (int i = 0; i < 14; ++i) {
    char name[16];
    std::snprintf(name, sizeof name, "%06d.png", i);
    cv::imwrite((sizes / "right" / name).string(), cv::Mat1b(60, 80, uint8_t(7)));
  }
  expect(sizes, fresh("o"), {"80x60"});

  const std::string calibration = read_file(session() / "calibration.yaml");
  const auto with_calibration = [&](const std::string& from, const std::string& to,
                                    const std::vector<std::string>& words) {
    const fs::path folder = copied("calibration");
    std::string text = calibration;
    const size_t at = text.find(from);
    ASSERT_NE(at, std::string::npos) << from;
    write_file(folder / "calibration.yaml", text.replace(at, from.size(), to));
    expect(folder, fresh("o"), words);
  };
  const std::string size = "image_width: 320",
                    rotation = "R: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 1., ";
  with_calibration(size, "image_width: 640", {"640"});
  with_calibration("data: [ -0.1, 0., 0. ]", "data: [ 0., 0., 0. ]", {"calibration.yaml", "baseline"});
  with_calibration("data: [ -0.1, 0., 0. ]", "data: [ 0.1, 0., 0. ]", {"calibration.yaml"});
  with_calibration("data: [ -0.1, 0., 0. ]", "data: [ .nan, 0., 0. ]", {"calibration.yaml"});
  with_calibration(rotation, rotation.substr(0, rotation.size() - 4) + "2., ", {"calibration.yaml", "rotation"});

  // The output of another session.
  const fs::path other = copied("other");
  fs::remove(other / "left/000000.png");
  fs::remove(other / "right/000000.png");
  expect(other, reference(), {"another session"});
  // A folder that cannot be made, and one that holds something else.
  expect(session(), session() / "calibration.yaml/out", {"calibration.yaml"});
  expect(session(), session(), {"choose"});
  EXPECT_EQ(run_program({"tour", session().string(), "-o", "x.mp4"}).exit_code, 3);
}

TEST_F(Cli, AFullDiskIsReportedAndNothingIsLost) {
  // A limit on the size of files stands for the full disk: writing fails half-way with an error of its own.
  const fs::path out = fresh("full");
  const auto result = run_program(run_arguments(session(), out), /*largest_file=*/200 * 1024);
  EXPECT_EQ(result.exit_code, 3) << result.output;
  EXPECT_THAT(result.output, HasSubstr("run the same command again"));
  ASSERT_EQ(run_program(run_arguments(session(), out)).exit_code, 0);
  expect_equal_products(reference(), out);
}

TEST_F(Cli, InfoTellsOfSessionsAndOutputs) {
  const auto recorded = run_program({"info", session().string()});
  EXPECT_EQ(recorded.exit_code, 0);
  EXPECT_THAT(recorded.output, AllOf(HasSubstr("frames       14"), HasSubstr("320 x 240"), HasSubstr("baseline 0.1")));
  const auto made = run_program({"info", reference().string()});
  EXPECT_EQ(made.exit_code, 0);
  EXPECT_THAT(made.output, AllOf(HasSubstr("14 with a pose"), HasSubstr("1 sub-map\n"), HasSubstr("model/scene.glb")));
}

TEST_F(Cli, DebugMotionWritesAPictureOfEachFrame) {
  const fs::path out = fresh("debug_motion");
  auto arguments = run_arguments(session(), out);
  arguments.push_back("--debug-motion");
  ASSERT_EQ(run_program(arguments).exit_code, 0);
  int pictures = 0;
  for (const auto& entry : fs::directory_iterator(out / "debug/motion")) pictures += entry.path().extension() == ".png";
  EXPECT_EQ(pictures, 14);
  fs::remove_all(out / "debug");
  expect_equal_products(reference(), out);  // they change nothing else
  const auto again = run_program(arguments);
  EXPECT_EQ(again.exit_code, 0);
  EXPECT_THAT(again.output, HasSubstr("found by an earlier run"));
  EXPECT_THAT(run_program({"info", out.string()}).output, HasSubstr("13 motions, never less than"));
}

TEST_F(Cli, ARecordingOfABareWallIsNoBug) {
  const fs::path bare = copied("bare"), out = fresh("bare_out");
  for (const auto& entry : fs::recursive_directory_iterator(bare)) {
    if (entry.path().extension() == ".png") cv::imwrite(entry.path().string(), cv::Mat1b(240, 320, uint8_t(120)));
  }
  const auto result = run_program(run_arguments(bare, out));
  EXPECT_EQ(result.exit_code, 3) << result.output;
  EXPECT_THAT(result.output, HasSubstr("show too little"));
}

TEST_F(Cli, UncompressedRecordingsOfOneSizeAreToldApart) {
  const fs::path a = copied("pgm_a"), b = copied("pgm_b"), out = fresh("pgm_out");
  for (const fs::path& folder : {a, b}) {
    for (const char* side : {"left", "right"}) {
      for (int i = 0; i < 14; ++i) {
        char name[16];
        std::snprintf(name, sizeof name, "%06d", i);
        const fs::path file = folder / side / name;
        cv::Mat image = cv::imread(file.string() + ".png", cv::IMREAD_GRAYSCALE);
        if (folder == b) image = 255 - image;
        fs::remove(file.string() + ".png");
        cv::imwrite(file.string() + ".pgm", image);
      }
    }
  }
  ASSERT_EQ(run_program(run_arguments(a, out)).exit_code, 0);
  EXPECT_EQ(run_program(run_arguments(b, out)).exit_code, 3);
}

TEST_F(Cli, RectifyWritesASessionAndStereoItsDisparities) {
  const fs::path rectified = fresh("rectified");
  ASSERT_EQ(run_program({"rectify", session().string(), "-o", rectified.string(), "--quiet"}).exit_code, 0);
  EXPECT_THAT(run_program({"info", rectified.string()}).output, HasSubstr("frames       14"));
  const fs::path disparity = folder_->path() / "d.png";
  ASSERT_EQ(run_program({"stereo", (rectified / "left/000003.png").string(), (rectified / "right/000003.png").string(),
                         "-o", disparity.string(), "--picture", (folder_->path() / "p.png").string()})
                .exit_code,
            0);
  const cv::Mat code = cv::imread(disparity.string(), cv::IMREAD_UNCHANGED);
  ASSERT_EQ(code.type(), CV_16UC1);
  EXPECT_GT(cv::countNonZero(code), code.rows * code.cols / 2);
  const auto more = [&](std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), {"stereo", (rectified / "left/000003.png").string(),
                                         (rectified / "right/000003.png").string(), "--quiet"});
    return run_program(arguments).exit_code;
  };
  const fs::path depth = folder_->path() / "z.png", points = folder_->path() / "points.ply";
  ASSERT_EQ(more({"-o", (folder_->path() / "d.pfm").string(), "--depth", depth.string(), "--ply", points.string(),
                  "--calibration", (rectified / "calibration.yaml").string()}),
            0);
  EXPECT_GT(cv::countNonZero(cv::Mat1w(cv::imread(depth.string(), cv::IMREAD_UNCHANGED))), code.rows * code.cols / 2);
  EXPECT_THAT(read_file(points), ::testing::StartsWith("ply\nformat binary_little_endian 1.0\n"));
  EXPECT_EQ(more({"-o", disparity.string(), "--depth", depth.string()}), 2);  // of which camera?
  EXPECT_EQ(more({"-o", "d.jpg"}), 2);
  EXPECT_EQ(more({"-o", disparity.string(), "--stereo.disparities", "300"}), 2);  // more than 16 bits hold
  // Nothing is overwritten: neither a recording nor an earlier result.
  EXPECT_EQ(run_program({"rectify", session().string(), "-o", session().string()}).exit_code, 3);
  EXPECT_EQ(run_program({"rectify", session().string(), "-o", rectified.string()}).exit_code, 3);
  EXPECT_EQ(run_program({"stereo", (rectified / "left/000003.png").string(), "nothing.png", "-o", "x.png"}).exit_code,
            3);
}

TEST_F(Cli, ExportAndTourMakeProductsAgain) {
  const fs::path out = fresh("exported");
  fs::copy(reference(), out, fs::copy_options::recursive);
  const auto scene_time = fs::last_write_time(out / "model/scene.glb");
  ASSERT_EQ(run_program({"export", out.string(), "--only", "map", "--mapping.cell", "0.2", "--quiet"}).exit_code, 0);
  EXPECT_THAT(read_file(out / "map/map.yaml"), HasSubstr("resolution: 0.2"));
  EXPECT_EQ(fs::last_write_time(out / "model/scene.glb"), scene_time);
  EXPECT_THAT(read_file(out / "options.toml"), HasSubstr("cell = 0.2 "));
  // Options of products that were not written again are not taken over.
  ASSERT_EQ(run_program({"export", out.string(), "--only", "trajectory", "--mapping.cell", "0.3", "--quiet"}).exit_code,
            0);
  EXPECT_THAT(read_file(out / "options.toml"), HasSubstr("cell = 0.2 "));
  EXPECT_EQ(run_program({"export", out.string(), "--only", "sculpture"}).exit_code, 2);
  const fs::path video = folder_->path() / "other.mp4";
  ASSERT_EQ(run_program({"tour", out.string(), "-o", video.string(), "--tour.seconds", "1", "--quiet"}).exit_code, 0);
  EXPECT_GT(fs::file_size(video), 1000u);
}

TEST_F(Cli, MeasureTellsDistancesAndHowSureTheyAre) {
  // Points that the first view measured, a fifth of the width from its borders.
  const RectifiedCamera camera = iris::testing::synthetic_camera();
  const cv::Mat1f truth =
      iris::testing::render_room(iris::testing::Room(), camera, iris::testing::synthetic_pose(0)).disparity.disparity;
  // The world of a run: x forward, y left, z up, its origin on the floor or below the first camera.
  std::istringstream tum(read_file(reference() / "trajectory/tum.txt"));
  double t = 0, x = 0, y = 0, z = 0;
  tum >> t >> x >> y >> z;
  const auto point = [&](int column, int row) {
    const Eigen::Vector3d p = camera.point(column, row, truth(row, column));
    return std::to_string(p.z() + x) + "," + std::to_string(-p.x() + y) + "," + std::to_string(-p.y() + z);
  };
  const Eigen::Vector3d way = camera.point(60, 60, truth(60, 60)) - camera.point(250, 90, truth(90, 250));
  const auto json = run_program({"measure", reference().string(), point(60, 60), point(250, 90), "--json", "-"});
  ASSERT_EQ(json.exit_code, 0) << json.output;
  const auto result = nlohmann::json::parse(json.output);
  EXPECT_FALSE(result["horizontal"].get<bool>());
  EXPECT_NEAR(result["distance"].get<double>(), way.norm(), 0.02 + 4 * result["sigma"].get<double>());
  EXPECT_GT(result["sigma"].get<double>(), 0.0005);
  EXPECT_LT(result["sigma"].get<double>(), 0.05);
  const auto text = run_program({"measure", reference().string(), point(60, 60), point(250, 90)});
  EXPECT_EQ(text.exit_code, 0);
  EXPECT_THAT(text.output, AllOf(HasSubstr("distance  "), HasSubstr(" ± "), HasSubstr("seen from view")));

  const auto far = run_program({"measure", reference().string(), "-.5,900", "1,0"});
  EXPECT_EQ(far.exit_code, 3);
  EXPECT_THAT(far.output, AllOf(HasSubstr("point A = (-0.5, 900)"), HasSubstr("the path goes from x")));
  EXPECT_EQ(run_program({"measure", reference().string(), "1;2", "1,0"}).exit_code, 2);
  EXPECT_EQ(run_program({"measure", reference().string(), "1,2", "1,0", "--submap", "7"}).exit_code, 2);
  EXPECT_EQ(run_program({"measure", session().string(), "1,2", "1,0"}).exit_code, 3);
  EXPECT_THAT(run_program({"measure", "--help"}).output, HasSubstr("plus or minus one standard deviation"));
}

// The truth of the simulated session as a session's truth/ folder has it, in a world that is turned and shifted.
void write_truth(const fs::path& folder, const fs::path& map_folder, int frames) {
  Pose world = Pose::Identity();
  world.linear() = Eigen::AngleAxisd(0.5, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  world.translation() = Eigen::Vector3d(20, -30, 1);
  std::string path;
  for (const char* name : {"disparity", "occlusion"}) fs::create_directories(folder / name);
  for (int i = 0; i < frames; ++i) {
    const Pose pose = world * z_up_from_camera() * iris::testing::synthetic_pose(i);
    const Eigen::Quaterniond q(pose.linear());
    const Eigen::Vector3d& t = pose.translation();
    char line[256];
    std::snprintf(line, sizeof line, "%d.%d %.9f %.9f %.9f %.9f %.9f %.9f %.9f\n", i / 10, i % 10, t.x(), t.y(), t.z(),
                  q.x(), q.y(), q.z(), q.w());
    path += line;
    const cv::Mat1f disparity = iris::testing::render_room(iris::testing::Room(), iris::testing::synthetic_camera(),
                                                           iris::testing::synthetic_pose(i))
                                    .disparity.disparity;
    cv::Mat1w code;
    disparity.convertTo(code, CV_16U, 256);
    char name[16];
    std::snprintf(name, sizeof name, "%06d.png", i);
    cv::imwrite((folder / "disparity" / name).string(), code);
    cv::imwrite((folder / "occlusion" / name).string(), cv::Mat1b(code.size(), uint8_t{0}));
  }
  write_file(folder / "trajectory.tum", path);
  // The plan is the map itself: it must lie upon itself through both worlds.
  const cv::Mat map = cv::imread((map_folder / "map.pgm").string(), cv::IMREAD_UNCHANGED);
  cv::imwrite((folder / "plan.png").string(), map);
  std::string yaml = read_file(map_folder / "map.yaml");
  double x = 0, y = 0;
  ASSERT_EQ(std::sscanf(yaml.c_str() + yaml.find("origin: ["), "origin: [%lf, %lf", &x, &y), 2);
  const Eigen::Vector3d origin = world * Eigen::Vector3d(x, y, 0);
  char text[256];
  std::snprintf(text, sizeof text, "image: plan.png\nresolution: 0.05\norigin: [%.9f, %.9f, 0.5]\n", origin.x(),
                origin.y());
  write_file(folder / "plan.yaml", text);
}

TEST_F(Cli, EvaluateComparesARunWithTheTruth) {
  const fs::path truth = fresh("with_truth"), plots = fresh("plots");
  write_truth(truth / "truth", reference() / "map", 14);
  const auto result = run_program({"evaluate", reference().string(), "--truth", truth.string(), "-o", plots.string(),
                                   "--json", (plots / "figures.json").string()});
  ASSERT_EQ(result.exit_code, 0) << result.output;
  EXPECT_THAT(result.output,
              AllOf(HasSubstr("Trajectory"), HasSubstr("Disparities"), HasSubstr("Map"), HasSubstr("NEES")));
  EXPECT_THAT(result.output.substr(0, result.output.find('\n')),
              AllOf(HasSubstr("ATE"), HasSubstr("drift"), HasSubstr("wrong disparities"), HasSubstr("map precision")));
  const auto figures = nlohmann::json::parse(read_file(plots / "figures.json"));
  EXPECT_EQ(figures["trajectory"]["poses"], 14);
  EXPECT_LT(figures["trajectory"]["ate_rmse"].get<double>(), 0.005);
  EXPECT_LT(figures["trajectory"]["camera_rotation"].get<double>(), 0.5);
  EXPECT_EQ(figures["trajectory"]["nees_edges"], 13);
  EXPECT_GT(figures["disparities"]["images"].get<int>(), 0);
  EXPECT_LT(figures["disparities"]["wrong_1px"].get<double>(), 10);
  EXPECT_GT(figures["map"]["occupied_precision"].get<double>(), 98);
  EXPECT_GT(figures["map"]["occupied_recall"].get<double>(), 98);
  EXPECT_GT(figures["map"]["free_precision"].get<double>(), 98);
  for (const char* file : {"trajectory_path.svg", "trajectory_translation_error.png", "disparity_error_000000.png",
                           "disparity_histogram.svg", "map_errors.png"}) {
    EXPECT_TRUE(fs::exists(plots / file)) << file;
  }
  // A path alone finds its truth in the session as well.
  const auto of_file = run_program(
      {"evaluate", (reference() / "trajectory/tum.txt").string(), "--truth", truth.string(), "--json", "-"});
  ASSERT_EQ(of_file.exit_code, 0) << of_file.output;
  EXPECT_EQ(nlohmann::json::parse(of_file.output)["trajectory"]["ate_rmse"], figures["trajectory"]["ate_rmse"]);
  // KITTI's truth has a line for each frame; fewer are of another session.
  write_file(truth / "short.txt", std::string("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 1\n"));
  const auto of_short = run_program({"evaluate", reference().string(), "--truth", (truth / "short.txt").string()});
  EXPECT_EQ(of_short.exit_code, 3);
  EXPECT_THAT(of_short.output, HasSubstr("has 2 lines"));
  // Further sub-maps are aligned by themselves; KITTI's poses belong to the frames.
  const fs::path parts = fresh("parts");
  fs::copy(reference(), parts, fs::copy_options::recursive);
  const std::string path = read_file(parts / "trajectory/tum.txt");
  size_t fifth_line = 0;
  for (int i = 0; i < 5; ++i) fifth_line = path.find('\n', fifth_line) + 1;
  write_file(parts / "trajectory/tum_submap1.txt", path.substr(0, path.find('\n') + 1));
  write_file(parts / "trajectory/tum_submap2.txt", path.substr(0, fifth_line));
  const auto of_parts = nlohmann::json::parse(
      run_program({"evaluate", parts.string(), "--truth", (truth / "truth/trajectory.tum").string(), "--json", "-"})
          .output)["trajectory"];
  EXPECT_EQ(of_parts["ate_rmse"], figures["trajectory"]["ate_rmse"]);
  ASSERT_EQ(of_parts["submaps"].size(), 2u);  // the third has a single pose
  EXPECT_EQ(of_parts["submaps"][1]["file"], "tum_submap2.txt");
  EXPECT_EQ(of_parts["submaps"][1]["poses"], 5);
  const auto as_kitti =
      nlohmann::json::parse(run_program({"evaluate", reference().string(), "--truth",
                                         (reference() / "trajectory/kitti.txt").string(), "--json", "-"})
                                .output)["trajectory"];
  EXPECT_EQ(as_kitti["poses"], 14);
  EXPECT_LT(as_kitti["ate_rmse"].get<double>(), 1e-9);
  // Single files, and JSON alone on the terminal.
  const auto single = run_program({"evaluate", (reference() / "trajectory/tum.txt").string(), "--truth",
                                   (truth / "truth/trajectory.tum").string(), "--json", "-"});
  EXPECT_EQ(nlohmann::json::parse(single.output)["trajectory"]["ate_rmse"], figures["trajectory"]["ate_rmse"]);
}

TEST_F(Cli, EvaluateRefusesOptionsThatItWouldNotLookAt) {
  const fs::path path = reference() / "trajectory/tum.txt";
  const auto expect = [&](const std::string& result, std::vector<std::string> options, const std::string& words) {
    options.insert(options.begin(), {"evaluate", result, "--truth", path.string()});
    const auto run = run_program(options);
    EXPECT_EQ(run.exit_code, 2) << run.output;
    EXPECT_THAT(run.output, HasSubstr(words));
  };
  expect(reference().string(), {"--mask", "black"}, "--mask is for the kind 'image'; compared is: trajectory");
  expect(reference().string(), {"--kind", "map"}, "--kind is for files");
  expect(reference().string(), {"--tolerance", "2"}, "--tolerance is for the kind 'map'");
  expect(path.string(), {"--round"}, "--round is for the kind 'disparity'");
  expect(path.string(), {"-o", fresh("plots").string(), "--view", "0"}, "--view is for output folders");
  EXPECT_EQ(run_program({"evaluate", path.string(), "--truth", path.string(), "--with-scale"}).exit_code, 0);
}

TEST_F(Cli, EvaluateSaysWhatDoesNotBelongTogether) {
  const fs::path truth = fresh("wrong_truth");
  fs::create_directories(truth);
  const auto expect = [&](const std::string& result, const fs::path& of, int code, const std::string& words) {
    const auto run = run_program({"evaluate", result, "--truth", of.string()});
    EXPECT_EQ(run.exit_code, code) << run.output;
    EXPECT_THAT(run.output, HasSubstr(words));
  };
  expect(reference().string(), truth, 3, "holds neither");
  write_file(truth / "trajectory.tum", "1000 0 0 0 0 0 0 1\n1001 1 0 0 0 0 0 1\n");
  expect(reference().string(), truth, 3, "1000.000 … 1001.000 s");
  expect(session().string(), truth, 3, "no output folder");
  EXPECT_EQ(run_program({"evaluate", reference().string()}).exit_code, 2);
  fs::remove(truth / "trajectory.tum");
  fs::create_directories(truth / "disparity");
  expect(reference().string(), truth, 3, "has no disparity image");
  cv::imwrite((truth / "disparity/000000.png").string(), cv::Mat1w(10, 10, uint16_t{256}));
  expect(reference().string(), truth, 3, "10 x 10 px");
}

}  // namespace
}  // namespace iris
