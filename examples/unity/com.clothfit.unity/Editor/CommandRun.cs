using System;
using System.ComponentModel;
using System.Diagnostics;
using System.Linq;
using System.Text;

namespace Clothfit.Editing
{
    /// <summary>
    /// A call of the command line that runs beside the editor. Threads of .NET read what it prints, so nothing here waits.
    /// </summary>
    public sealed class CommandRun : IDisposable
    {
        const double Patience = 60; // s from a request to end until the process is killed

        readonly Process process;
        readonly StringBuilder output = new StringBuilder(), errors = new StringBuilder();
        DateTime? asked;
        bool outputEnded, errorsEnded;

        /// <summary>Starts it. Throws InvalidOperationException where the system cannot.</summary>
        public CommandRun(ProcessStartInfo call)
        {
            process = new Process { StartInfo = call };
            process.OutputDataReceived += (sender, line) => Keep(output, line.Data, ref outputEnded);
            process.ErrorDataReceived += (sender, line) => Keep(errors, line.Data, ref errorsEnded);
            try
            {
                process.Start();
            }
            catch (Win32Exception error)
            {
                throw new InvalidOperationException(call.FileName + " cannot be started: " + error.Message, error);
            }
            process.BeginOutputReadLine();
            process.BeginErrorReadLine();
        }

        public int Id
        {
            get { return process.Id; }
        }

        /// <summary>Whether somebody has asked it to end.</summary>
        public bool Cancelled
        {
            get { return asked != null; }
        }

        /// <summary>What it has printed as its result.</summary>
        public string Output
        {
            get { lock (output) return output.ToString(); }
        }

        /// <summary>What it has said: progress, warnings, errors.</summary>
        public string Errors
        {
            get { lock (errors) return errors.ToString(); }
        }

        /// <summary>What it says went wrong, without the word error: one line, or "" where it says nothing.</summary>
        public string Fault
        {
            get
            {
                const string mark = "error: ";
                string[] lines = Errors.Split('\n').Select(each => each.Trim()).Where(each => each.Length > 0).ToArray();
                string last = lines.LastOrDefault(each => each.StartsWith(mark, StringComparison.Ordinal)) ?? lines.LastOrDefault();
                return last == null ? "" : last.StartsWith(mark, StringComparison.Ordinal) ? last.Substring(mark.Length) : last;
            }
        }

        /// <summary>Its exit code once it has ended and all it printed has been read; null before.</summary>
        public int? Ended()
        {
            if (!process.HasExited)
            {
                if (asked != null && (DateTime.UtcNow - asked.Value).TotalSeconds > Patience) process.Kill();
                return null;
            }
            lock (output) if (!outputEnded) return null;
            lock (errors) if (!errorsEnded) return null;
            return process.ExitCode;
        }

        /// <summary>
        /// Asks it to end by closing its input, on which --end-with-input has an eye; it then writes the best so far. The
        /// same happens where the editor itself ends. After a minute without an answer it is killed.
        /// </summary>
        public void Cancel()
        {
            if (asked != null || process.HasExited) return;
            asked = DateTime.UtcNow;
            process.StandardInput.Close();
        }

        public void Dispose()
        {
            if (!process.HasExited) Cancel();
            process.Dispose();
        }

        static void Keep(StringBuilder text, string line, ref bool ended)
        {
            lock (text)
            {
                if (line == null) ended = true;
                else text.Append(line).Append('\n');
            }
        }
    }
}
