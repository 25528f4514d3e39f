using System.IO;
using System.Linq;
using UnityEngine;

namespace Clothfit.Editing
{
    /// <summary>Where the files of a scene are: in the folder Clothfit beside Assets.</summary>
    public static class ProjectFiles
    {
        /// <summary>The folder of the project, from which paths of targets count.</summary>
        public static string Folder
        {
            get { return Path.GetDirectoryName(Path.GetFullPath(Application.dataPath)); }
        }

        public static string Scene(ClothfitScene settings)
        {
            return Path.Combine(Folder, "Clothfit", Stem(settings.name) + ".txt");
        }

        public static string Fitted(ClothfitScene settings)
        {
            return Path.Combine(Folder, "Clothfit", Stem(settings.name) + ".fitted.txt");
        }

        public static string Motion(ClothfitScene settings, string kind)
        {
            return Path.Combine(Folder, "Clothfit", Stem(settings.name) + "." + kind + ".pc2");
        }

        /// <summary>A name without what no file's name may have on any system.</summary>
        public static string Stem(string name)
        {
            const string refused = "<>:\"/\\|?*";
            string stem = new string(name.Select(each => each < ' ' || refused.IndexOf(each) >= 0 ? '_' : each).ToArray());
            stem = stem.Trim(' ', '.');
            return stem.Length == 0 ? "scene" : stem;
        }
    }
}
