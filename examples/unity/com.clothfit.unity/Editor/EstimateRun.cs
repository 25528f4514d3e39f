using System;
using System.Collections.Generic;
using System.Globalization;
using System.IO;
using System.Linq;
using UnityEngine;

namespace Clothfit.Editing
{
    /// <summary>How a fit ended.</summary>
    public enum Outcome
    {
        Converged,
        Short, // ended without reaching its tolerance; the best is written
        Cancelled, // the best so far is written
        Failed, // nothing is written
    }

    /// <summary>A fit that runs beside the editor: `clothfit estimate` with its log and its summary.</summary>
    public sealed class EstimateRun : IDisposable
    {
        const int Done = 0, NotReached = 5, Interrupted = 130; // exit codes

        public readonly string FittedPath;

        readonly CommandRun run;
        readonly string log;
        long read; // bytes of the log
        string rest = ""; // a line that has not come whole

        /// <summary>Starts a fit of a scene file to the target of the settings. Throws InvalidOperationException.</summary>
        public EstimateRun(Command command, string scene, string fitted, ClothfitScene settings, string folder)
        {
            FittedPath = fitted;
            log = Path.Combine(Path.GetTempPath(), "clothfit-" + Guid.NewGuid().ToString("N") + ".jsonl");
            run = new CommandRun(command.Call(Arguments(scene, fitted, log, settings), folder));
            Progress = "starting";
        }

        /// <summary>How far it is, for the user.</summary>
        public string Progress { get; private set; }

        /// <summary>What it printed at its end; null before, and where it printed none.</summary>
        public Summary Summary { get; private set; }

        /// <summary>What the user should know at the end.</summary>
        public string Message { get; private set; }

        public int Id
        {
            get { return run.Id; }
        }

        /// <summary>Whether somebody has asked it to end.</summary>
        public bool Cancelled
        {
            get { return run.Cancelled; }
        }

        public static List<string> Arguments(string scene, string fitted, string log, ClothfitScene settings)
        {
            var arguments = new List<string> { "estimate", scene, "-o", fitted, "--json", "--log", log, "--end-with-input" };
            if (settings.target.Length > 0) arguments.AddRange(new[] { "--target", settings.target });
            if (settings.target.Length > 0 && settings.targetRate > 0)
                arguments.AddRange(new[] { "--fps", settings.targetRate.ToString("R", CultureInfo.InvariantCulture) });
            arguments.AddRange(settings.options.Split(new[] { ' ' }, StringSplitOptions.RemoveEmptyEntries));
            return arguments;
        }

        /// <summary>Reads its progress; how it ended once it has, null before.</summary>
        public Outcome? Poll()
        {
            ReadLog();
            int? code = run.Ended();
            if (code == null) return null;
            if (run.Output.Trim().Length > 0) Summary = JsonUtility.FromJson<Summary>(run.Output);
            TryDelete(log);
            return End(code.Value);
        }

        public void Cancel()
        {
            Progress = "ending; the best so far is written";
            run.Cancel();
        }

        public void Dispose()
        {
            run.Dispose();
        }

        Outcome End(int code)
        {
            bool written = Summary != null && !string.IsNullOrEmpty(Summary.output) && File.Exists(FittedPath);
            if (written && (code == Done || code == NotReached || code == Interrupted))
            {
                Message = Summary.ToString() + string.Concat(Summary.hints.Select(hint => "\nhint: " + hint.text));
                return code == Done ? Outcome.Converged : code == NotReached ? Outcome.Short : Outcome.Cancelled;
            }
            if (run.Cancelled || code == Interrupted)
            {
                Message = "cancelled before there was a result";
                return Outcome.Failed;
            }
            Message = run.Fault.Length > 0 ? run.Fault : "clothfit ended with exit code " + code + " and said nothing";
            return Outcome.Failed;
        }

        void ReadLog()
        {
            if (run.Cancelled || !File.Exists(log)) return;
            using (var stream = new FileStream(log, FileMode.Open, FileAccess.Read, FileShare.ReadWrite | FileShare.Delete))
            {
                stream.Seek(read, SeekOrigin.Begin);
                string text = rest + new StreamReader(stream).ReadToEnd();
                read = stream.Position;
                int end = text.LastIndexOf('\n') + 1;
                rest = text.Substring(end);
                string last = text.Substring(0, end).Split('\n')
                    .LastOrDefault(each => each.StartsWith("{\"iteration\"", StringComparison.Ordinal));
                if (last != null) Progress = JsonUtility.FromJson<Iteration>(last).ToString();
            }
        }

        static void TryDelete(string path)
        {
            try
            {
                File.Delete(path);
            }
            catch (IOException)
            {
                // it stays in the folder of temporary files
            }
        }
    }

    /// <summary>A line of the log of a fit.</summary>
    [Serializable]
    public class Iteration
    {
        public int iteration, evaluations, window, frames;
        public double seconds, rmse; // s, m
        public string stage = "";

        public override string ToString()
        {
            return string.Format(CultureInfo.InvariantCulture, "{0}, {1} of {2} frames, RMSE {3:g3} mm, {4} evaluations, {5:0} s",
                stage, window, frames, 1000 * rmse, evaluations, seconds);
        }
    }

    /// <summary>What a fit prints at its end.</summary>
    [Serializable]
    public class Summary
    {
        public string status = "", output = "";
        public double rmse, relative_rmse, seconds;
        public int frames, evaluations;
        public List<Hint> hints = new List<Hint>();

        public override string ToString()
        {
            return string.Format(CultureInfo.InvariantCulture, "{0}: RMSE {1:g3} mm over {2} frames, {3:g2} % of the way, {4:0.0} s",
                status, 1000 * rmse, frames, 100 * relative_rmse, seconds);
        }
    }

    [Serializable]
    public class Hint
    {
        public string code = "", text = "";
    }
}
