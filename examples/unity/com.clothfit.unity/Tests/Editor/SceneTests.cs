using System;
using System.Linq;
using NUnit.Framework;
using UnityEngine;

namespace Clothfit.Testing
{
    /// <summary>Scenes that are put together from components, built, written and read; for Unity's Test Runner.</summary>
    public class SceneTests
    {
        GameObject root;
        ClothfitScene settings;
        ClothfitCloth cloth;

        [SetUp]
        public void Make()
        {
            root = new GameObject("Curtain", typeof(ClothfitScene));
            settings = root.GetComponent<ClothfitScene>();
            var sheet = new GameObject("Cloth", typeof(MeshFilter), typeof(ClothfitPlane), typeof(ClothfitCloth));
            sheet.transform.SetParent(root.transform, false);
            var plane = sheet.GetComponent<ClothfitPlane>();
            plane.divisions = 4;
            plane.Make();
            cloth = sheet.GetComponent<ClothfitCloth>();
            var fixer = new GameObject("Fixer", typeof(ClothfitFixer));
            fixer.transform.SetParent(root.transform, false);
            fixer.transform.localPosition = new Vector3(-1f, 0f, 0f);
            fixer.transform.localScale = new Vector3(0.1f, 0.1f, 2.2f);
        }

        [Test]
        public void ThePlaneIsHeldAtOneSideAndWeighsItsDensityTimesItsArea()
        {
            ObjectData data = SceneBuilder.Build(settings).Scene.objects[0];
            Assert.AreEqual(36, data.vertPos.Count);
            Assert.AreEqual(6, data.vertIsFixed.Count(each => each));
            Assert.AreEqual(4f * cloth.density, data.vertMass.Sum(), 1e-5f);
        }

        [Test]
        public void AWrittenSceneReadsBackAsTheSameText()
        {
            string text = SceneBuilder.Build(settings).ToString();
            Assert.AreEqual(text, SceneFile.Parse(text).ToString());
        }

        [Test]
        public void FittedStiffnessesComeBack()
        {
            cloth.fitStiffness = FittedMany.Each;
            SceneFile file = SceneBuilder.Build(settings);
            ObjectData data = file.Scene.objects[0];
            for (int k = 0; k < data.springStiffness.Count; k++) data.springStiffness[k] = 3f + k;
            SceneImport.Apply(file, settings);
            Assert.AreEqual(3f, cloth.fitted.stiffnesses[0], 0f);
            Assert.AreEqual(data.springStiffness.Count, cloth.fitted.stiffnesses.Count);
        }

        [Test]
        public void ASceneOfAnotherMeshIsRefused()
        {
            SceneFile file = SceneBuilder.Build(settings);
            file.Scene.objects[0].vertMass.RemoveAt(0);
            Assert.Throws<InvalidOperationException>(() => SceneImport.Apply(file, settings));
        }

        [Test]
        public void TextThatIsNoSceneIsRefused()
        {
            Assert.Throws<FormatException>(() => SceneFile.Parse("{}"));
        }
    }
}
